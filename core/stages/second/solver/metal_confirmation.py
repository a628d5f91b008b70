# SPDX-License-Identifier: GPL-3.0-or-later
"""Test of regions that may be metal: a region is metal if the photographs are explained clearly better so.

Light and albedo adapt to either hypothesis. Without that, the light that was solved decides, and not the photographs: it has adapted to
what the points were taken for before. A region that gains too little, or is too rough, is tested once more where its colours are those of
the metal that was found: on a figure with a golden belt, the arm rings were missed in some runs of the solver.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Generic, NamedTuple, TypeVar

import torch

from ....io.srgb import encode_srgb
from ..metal import MEAN_METALLIC_THRESHOLD
from .multi_view_samples import MultiViewSamples

# Least gain of a region as a share of the robust error of all samples. Regions of metal gained .0086 and more on capture_ogre (five seeds
# of the solver), .022 and more on rocker_corner and suzanne_mixed; the small keyhole of a padlock gained .002 to .008, and was missed when
# there was no limit for sharp regions. On five objects, regions of other materials gained .0015 at most, but for those that
# MAX_METAL_ROUGHNESS leaves out: up to .02.
MIN_REGION_GAIN = 0.008
# A small region needs no more than its share of the points, but at least this. False regions of so few points gained at most .003.
MIN_SMALL_REGION_GAIN = 0.006
# Where reflections are sharp, by their median roughness, this gain and MIN_GAIN_PER_SHARE are enough. Five regions of 6 to 18 points, 56
# to 100 per cent of them metal, on a toy car, with masks and captured, had a roughness of .21 to .47 and gained .0017 to .0048, .39 to 1.3
# times their share. On five objects three regions without metal were as sharp: they gained .0003 and less, and .0012, .19 times its share.
# One on capture_ogre, which was not compared with the truth, gained .0004.
SHARP_ROUGHNESS, MIN_SHARP_REGION_GAIN = 0.5, 0.0015
# A large region needs a larger gain: MIN_GAIN_PER_SHARE times its share of the points. Leaves of a captured plant, which are no metal,
# gained 0.23 and 0.27 times their share in fewer steps; regions of metal on four scenes, 0.35 times and more.
MIN_GAIN_PER_SHARE = 0.3
# The same for a region of at least MIN_SPREAD_SHARE of the points whose colours change much from view to view, as reflections do. The lid
# and upper ribs of a captured tin, 26 % of the points, gain .23 times their share, and change 4.1 times as much as other points. Metal on
# seven objects changes 2.2 to 5.8 times as much; large regions of other materials .6 to 1.8 times, but small ones where the surface is
# wrong, such as leaves, up to 6.4 times.
MIN_GAIN_PER_SHARE_BY_SPREAD, MIN_SPREAD, MIN_SPREAD_SHARE = 0.15, 2.5, 0.1
# Share of a sharp region's least gain that is enough where colours are those of metal. In 13 runs of the solver, on capture_ogre and on a
# toy car, captured and with masks, 21 regions that were not confirmed before had evidence above 0 by their colours. 19 were mostly metal:
# 16 of them are confirmed so, and gained .0010 to .0125; the others have 4 points. The two without metal, of 6 and 16 points, gained .0014
# and .0013; the smaller one is confirmed. In all, such a region must gain something alone: the errors of other points waver by up to .003.
# Part of an arm ring of capture_ogre gained .0032, of which the others lost .0026.
LIKE_METAL_GAIN = 0.5
# Mean evidence from which a region's colours are those of metal, see `colour_evidence`. Thirteen regions of metal had .24 and more, one of
# 4 points had .02. A region of 33 points without metal had 0, and gained .0024; another one had .59, but gained too little.
MIN_EVIDENCE = 0.1
MAX_DARK_SHARE = 0.5  # share of a region's points that are too dark for metal, from which its colours are not those of metal
# Median roughness above which a region is not tested, each point weighted by its gain: where the surface is wrong, in gaps and at contacts,
# rough metal explains shadows better. Of 33 false regions on five objects, 21 had .78 to .85, and the others gained .0015 at most; 15
# regions of metal on four objects had .21 to .73. The plain median of an ear of suzanne_mixed was .85 for one seed: where normals are
# wrong, reflections look rough, but gain little.
MAX_METAL_ROUGHNESS = 0.75

Solution = TypeVar("Solution")


class Hypothesis(NamedTuple, Generic[Solution]):
    """Which points are metal, and what follows from that.

    Attributes:
        metal: (P,) bool.
        solution: light and materials that have adapted to it.
        errors: (P,) robust error of each point then.
    """

    metal: torch.Tensor
    solution: Solution
    errors: torch.Tensor


Adapt = Callable[[torch.Tensor], Hypothesis[Solution]]  # lets light and albedo adapt to the points (P,) bool that are metal


class MetalRegion(NamedTuple):
    """Region that may be metal.

    Attributes:
        points: (P,) bool.
        roughness: median roughness of its points as metal, each weighted by its gain.
        spread: how much its colours change from view to view, in multiples of how much those of points outside of all regions do.
        like_metal: its colours are those of metal that was found.
    """

    points: torch.Tensor
    roughness: float
    spread: float = 1.0
    like_metal: bool = False

    @property
    def is_sharp_enough(self) -> bool:
        """True where reflections are sharp enough to tell metal from a rough dielectric by what it gains."""
        return self.roughness <= MAX_METAL_ROUGHNESS

    @property
    def least_gain(self) -> float:
        """Gain that the region needs, as a share of the robust error of all samples."""
        share = float(self.points.float().mean())
        # Whether most of an object is metal is decided by other evidence, too: what the first stage found, and what is left without metal.
        if share > MEAN_METALLIC_THRESHOLD:
            return MIN_REGION_GAIN
        varies = self.spread >= MIN_SPREAD and share >= MIN_SPREAD_SHARE
        by_share = (MIN_GAIN_PER_SHARE_BY_SPREAD if varies else MIN_GAIN_PER_SHARE) * share
        if self.like_metal:
            return LIKE_METAL_GAIN * max(MIN_SHARP_REGION_GAIN, by_share)
        if self.roughness <= SHARP_ROUGHNESS:
            return max(MIN_SHARP_REGION_GAIN, by_share)
        return max(min(max(share, MIN_SMALL_REGION_GAIN), MIN_REGION_GAIN), by_share)


def measured_regions(
    regions: list[torch.Tensor], samples: MultiViewSamples, roughness: torch.Tensor, gain: torch.Tensor
) -> list[MetalRegion]:
    """Return regions with their roughness, and how much their colours change from view to view.

    Args:
        regions: masks (P,) bool.
        samples: multi-view samples of P points.
        roughness: (P,) of the points as metal.
        gain: (P,) by how much their robust error falls where they are metal.
    """
    if not regions:
        return []
    spread, others = _colour_spread(samples), ~torch.stack(regions).any(0)
    usual = float(spread[others].median()) if bool(others.any()) else math.inf  # nothing to compare with
    return [
        MetalRegion(region, _weighted_median(roughness[region], gain[region].clamp_min(0)), float(spread[region].median()) / usual)
        for region in regions
    ]


def confirm_metal(
    regions: list[MetalRegion],
    without: Hypothesis[Solution],
    adapt: Adapt[Solution],
    colours: Callable[[Solution, torch.Tensor], tuple[torch.Tensor, torch.Tensor]],
) -> Hypothesis[Solution]:
    """Test the regions that are sharp enough, and then those of the others whose colours are those of the metal that was found.

    Args:
        regions: regions of P points.
        without: nothing is metal.
        adapt: returns a hypothesis with the given points as metal.
        colours: returns evidence for metal, and points that are too dark, by a solution and its metal; see `MaterialSearch.metal_colours`.
    """
    best = _confirm_in_turn([region for region in regions if region.is_sharp_enough], without, adapt)
    if not bool(best.metal.any()):
        return best
    return _confirm_in_turn(_like_metal(regions, best.metal, *colours(best.solution, best.metal)), best, adapt)


def completed_metal(metal: torch.Tensor, adapt: Adapt[Solution]) -> torch.Tensor:
    """Return all points for an object that is mostly metal, unless its other points clearly contradict that.

    Wrong normals make a part of a metal object look like a dielectric: on a metal figure, the underside of its base did.

    Args:
        metal: (P,) bool.
        adapt: see `confirm_metal`.
    """
    if float(metal.float().mean()) <= MEAN_METALLIC_THRESHOLD or bool(metal.all()):
        return metal
    mixed, whole = (float(adapt(points).errors.sum()) for points in (metal, torch.ones_like(metal)))
    return torch.ones_like(metal) if whole - mixed <= MIN_REGION_GAIN * mixed else metal


def _colour_spread(samples: MultiViewSamples) -> torch.Tensor:
    """Return how much the encoded colours of each point (P,) differ from view to view: standard deviation, root mean square of channels."""
    colour, count = encode_srgb(samples.colour), samples.lengths[:, None]
    difference = colour - (samples.sums(colour) / count)[samples.point]
    return (samples.sums(difference.square()) / count).mean(1).sqrt().clamp_min(1e-6)


def _weighted_median(values: torch.Tensor, weight: torch.Tensor) -> float:
    """Return the value (P,) below which lies half of the weight (P,) >= 0; the largest where there is none."""
    order = values.argsort()
    below = weight[order].cumsum(0)
    return float(values[order][int((below < 0.5 * below[-1]).sum())]) if float(below[-1]) > 0 else float(values.max())


def _confirm_in_turn(regions: list[MetalRegion], start: Hypothesis[Solution], adapt: Adapt[Solution]) -> Hypothesis[Solution]:
    """Decide one region after the other, in their order: metal, if the photographs are explained better so."""
    best = start
    for region in regions:
        points, needed = region.points, region.least_gain * float(best.errors.sum())
        if float(best.errors[points].sum()) <= needed:  # it cannot gain more than its error
            continue
        trial = adapt(best.metal | points)
        gain = best.errors - trial.errors
        own, total = float(gain[points].sum()), float(gain.sum())
        if own > needed and total > (0 if region.like_metal else needed):
            best = trial
    return best


def _like_metal(regions: list[MetalRegion], metal: torch.Tensor, evidence: torch.Tensor, dark: torch.Tensor) -> list[MetalRegion]:
    """Return the regions without `metal` (P,) whose colours are like it, by `evidence` (P,), and few of whose points are `dark` (P,)."""

    def mean(values: torch.Tensor, region: MetalRegion) -> float:
        return float(values[region.points].float().mean())

    others = [region._replace(like_metal=True) for region in regions if not bool((region.points & metal).any())]
    return [region for region in others if mean(evidence, region) > MIN_EVIDENCE and mean(dark, region) < MAX_DARK_SHARE]
