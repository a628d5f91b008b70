# SPDX-License-Identifier: GPL-3.0-or-later
"""Regions of metal: points with clear evidence, those around that do not contradict it, and a test of each region as a whole.

A single point hardly tells metal from a rough dielectric: wrong normals and shadows make either fit a little better. The search has four
steps (called by `LightMaterialSolver`):

1. Candidates, by two thresholds as in Canny's edge detector: a point needs clear evidence (MIN_SURE_GAIN), unless its neighbours are
   candidates (MIN_POSSIBLE_GAIN). They count as metal until the test, so that the light adapts to them: else a region that was missed once
   was seldom found again.
2. Before the test, light and albedo adapt to the candidates. Those that metal does not explain better then are dropped (MIN_SUPPORT_GAIN).
   Without this, metal spread in the shadow from a belt to the skin around it.
3. The test: each connected region counts as metal only if the photographs are explained clearly better so, see `confirm_metal`.
4. A graph cut draws the borders of the confirmed regions anew, see `metal_cut`; at the end by their tint, too, see `metal_colours`.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple, TypeVar

import numpy as np
import torch
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components

from ....io.srgb import encode_srgb
from ...common.nearest_neighbours import nearest_neighbours
from ..metal import MEAN_METALLIC_THRESHOLD

NEIGHBOURS = 13  # of a point, the point itself included
# Exponential decay of similarity with differences of chromaticity and of encoded colour, channels summed.
CHROMATICITY_DECAY, ENCODED_DECAY = 15, 3
CHROMATICITY_OFFSET = 0.02  # radiance added to the sum of the channels, so that the chromaticity of dark points tells little
MIN_SURE_GAIN = 0.4  # gain per view from which a point is a candidate; the gain is a difference of robust costs, see `MaterialSearch`
MIN_POSSIBLE_GAIN = -0.3  # gain from which a point is a candidate where its neighbours are
MIN_NEIGHBOUR_SHARE = 0.1  # share of the neighbours, by similarity of colour, that must be metal
MIN_LINK_SIMILARITY = 0.02  # similarity from which a neighbour belongs to the same region
MIN_REGION_POINTS, MAX_REGIONS = 4, 16  # points of a region, and regions that are tested
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
# Median roughness above which a region is not tested, each point weighted by its gain: where the surface is wrong, in gaps and at contacts,
# rough metal explains shadows better. Of 33 false regions on five objects, 21 had .78 to .85, and the others gained .0015 at most; 15
# regions of metal on four objects had .21 to .73. The plain median of an ear of suzanne_mixed was .85 for one seed: where normals are
# wrong, reflections look rough, but gain little.
MAX_METAL_ROUGHNESS = 0.75
MIN_SUPPORT_GAIN, SUPPORT_PASSES = 0.1, 3  # gain per view, with an adapted light, from which a candidate stays one; passes that average it

Solution = TypeVar("Solution")


class MetalRegion(NamedTuple):
    """Region that may be metal.

    Attributes:
        points: (P,) bool.
        roughness: median roughness of its points as metal, each weighted by its gain.
    """

    points: torch.Tensor
    roughness: float


def neighbourhood(position: torch.Tensor, colour: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
    """Find the nearest NEIGHBOURS of each point, itself included.

    Args:
        position: (P, 3).
        colour: (P, 3) linear.

    Returns:
        Indices (P, N), and weights by similarity of colour (P, N) that sum to 1.
    """
    index = nearest_neighbours(position, position, NEIGHBOURS)
    chromaticity, encoded = colour / (colour.sum(1, keepdim=True) + CHROMATICITY_OFFSET), encode_srgb(colour)
    difference = CHROMATICITY_DECAY * (chromaticity[:, None] - chromaticity[index]).abs().sum(-1)
    difference = difference + ENCODED_DECAY * (encoded[:, None] - encoded[index]).abs().sum(-1)
    similarity = torch.exp(-difference)
    return index, similarity / similarity.sum(1, keepdim=True)


def grow_metal(gain: torch.Tensor, neighbours: torch.Tensor, similarity: torch.Tensor) -> torch.Tensor:
    """Find the points that may be metal: those with clear evidence, and those around that do not contradict it.

    Args:
        gain: (P,) by how much less a metal's fit costs than a dielectric's, per view.
        neighbours: (P, N) indices of points.
        similarity: (P, N) weights of these, which sum to 1.

    Returns:
        (P,) bool.
    """
    metal, possible = gain > MIN_SURE_GAIN, gain > MIN_POSSIBLE_GAIN
    while True:
        grown = metal | (possible & ((similarity * metal[neighbours]).sum(1) > MIN_NEIGHBOUR_SHARE))
        if bool((grown == metal).all()):
            return metal
        metal = grown


def connected_regions(metal: torch.Tensor, neighbours: torch.Tensor, similarity: torch.Tensor) -> list[torch.Tensor]:
    """Split points into regions that are connected by neighbours of like colour.

    Args:
        metal: (P,) bool.
        neighbours: (P, N) indices of points.
        similarity: (P, N) weights of these.

    Returns:
        Up to MAX_REGIONS masks (P,) bool of regions with MIN_REGION_POINTS points or more, the largest first.
    """
    linked = metal[:, None] & metal[neighbours] & (similarity > MIN_LINK_SIMILARITY)
    row, column = torch.nonzero(linked, as_tuple=True)
    pairs = (row.cpu().numpy(), neighbours[row, column].cpu().numpy())
    _, label = connected_components(coo_matrix((np.ones(len(row)), pairs), (len(metal), len(metal))), directed=False)
    label = torch.from_numpy(label).to(metal.device)
    names, counts = label[metal].unique(return_counts=True)
    largest = counts.sort(descending=True, stable=True).indices[:MAX_REGIONS]
    return [metal & (label == names[k]) for k in largest if counts[k] >= MIN_REGION_POINTS]


def regions_to_test(regions: list[torch.Tensor], roughness: torch.Tensor, gain: torch.Tensor) -> list[MetalRegion]:
    """Return the regions that can be tested: reflections must be sharp enough to tell metal from a rough dielectric.

    Args:
        regions: masks (P,) bool.
        roughness: (P,) of the points as metal.
        gain: (P,) by how much their robust error falls where they are metal.
    """
    found = [MetalRegion(region, _weighted_median(roughness[region], gain[region].clamp_min(0))) for region in regions]
    return [region for region in found if region.roughness <= MAX_METAL_ROUGHNESS]


def _weighted_median(values: torch.Tensor, weight: torch.Tensor) -> float:
    """Return the value (P,) below which lies half of the weight (P,) >= 0; the largest where there is none."""
    order = values.argsort()
    below = weight[order].cumsum(0)
    return float(values[order][int((below < 0.5 * below[-1]).sum())]) if float(below[-1]) > 0 else float(values.max())


def confirm_metal(
    regions: list[MetalRegion],
    without: tuple[Solution, torch.Tensor],
    adapt: Callable[[torch.Tensor], tuple[Solution, torch.Tensor]],
) -> tuple[Solution, torch.Tensor, int]:
    """Decide one region after the other, the largest first: metal, if the photographs are explained better so.

    Light and albedo adapt to either hypothesis. Without that, the light that was solved decides, and not the photographs: it has
    adapted to what the points were taken for before.

    Args:
        regions: regions of P points.
        without: what `adapt` returns for no metal at all.
        adapt: solves for light and albedo with the given points (P,) bool as metal; returns the solution and the robust errors (P,).

    Returns:
        The solution with the metal that is confirmed, its robust errors (P,), and the number of regions that are metal.
    """
    best, least = without
    metal, confirmed = torch.zeros_like(least, dtype=torch.bool), 0
    for region in regions:
        points, needed = region.points, _least_gain(region) * float(least.sum())
        if float(least[points].sum()) <= needed:  # it cannot gain more than its error
            continue
        trial, errors = adapt(metal | points)
        gain = least - errors
        if min(float(gain[points].sum()), float(gain.sum())) > needed:
            metal, best, least, confirmed = metal | points, trial, errors, confirmed + 1
    return best, least, confirmed


def completed_metal(metal: torch.Tensor, adapt: Callable[[torch.Tensor], tuple[Solution, torch.Tensor]]) -> torch.Tensor:
    """Return all points for an object that is mostly metal, unless its other points clearly contradict that.

    Wrong normals make a part of a metal object look like a dielectric: on a metal figure, the underside of its base did.

    Args:
        metal: (P,) bool.
        adapt: see `confirm_metal`.
    """
    if float(metal.float().mean()) <= MEAN_METALLIC_THRESHOLD or bool(metal.all()):
        return metal
    mixed, whole = (float(adapt(points)[1].sum()) for points in (metal, torch.ones_like(metal)))
    return torch.ones_like(metal) if whole - mixed <= MIN_REGION_GAIN * mixed else metal


def _least_gain(region: MetalRegion) -> float:
    """Return the gain that a region needs, as a share of the robust error of all samples."""
    share = float(region.points.float().mean())
    # Whether most of an object is metal is decided by other evidence, too: what the first stage found, and what is left without metal.
    if share > MEAN_METALLIC_THRESHOLD:
        return MIN_REGION_GAIN
    by_share = MIN_GAIN_PER_SHARE * share
    if region.roughness <= SHARP_ROUGHNESS:
        return max(MIN_SHARP_REGION_GAIN, by_share)
    return max(min(max(share, MIN_SMALL_REGION_GAIN), MIN_REGION_GAIN), by_share)
