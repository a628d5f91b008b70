# SPDX-License-Identifier: GPL-3.0-or-later
"""Borders of metal among surfels, finer than the solver's points, of which there are far fewer.

The nearest points tell which surfels may be metal. Those are fitted as either, and a graph cut draws the border by the ratio of their
errors, by their tints (`metal_colours`), and by what most of the nearest points are. The majority alone made the borders ragged, and narrow
parts narrower.
"""

from __future__ import annotations

from typing import NamedTuple

import torch

from ...common.nearest_neighbours import nearest_neighbours
from ..metal import METALLIC_THRESHOLD
from .metal_colours import colour_evidence, too_dark
from .metal_cut import COLOUR_PASSES, MAX_EVIDENCE, least_cut
from .metal_regions import neighbourhood

MAJORITY_POINTS = 8  # solver points whose majority counts as evidence
ROUGHNESS_POINTS = 16  # solver points that tell what a surfel may be, and of which those that are metal, or are not, give its roughness
# Weights of the evidence, set on four objects. Surfels of another material that became metal, and surfels of metal that did not, by the
# majority of points -> by the cut: capture_ogre (4135 of metal) 565 and 855 -> 462 and 370; rocker_corner (663) 9 and 76 -> 7 and 55;
# suzanne_mixed (1141) 21 and 86 -> 4 and 40; a padlock (4027) 25 and 594 -> 63 and 505. With another seed of the solver, on which nothing
# was set: 430 and 996 -> 210 and 423; 34 and 101 -> 7 and 84; 21 and 595 -> 0 and 587 (no point of an ear was metal); 20 and 579 -> 101 and
# 518.
# Priors of .2 to .4, weights of points of .4 to .8 and of colours of .3 to .6, and couplings of 3 to 6 give about the same.
PRIOR = 0.3  # added to the evidence: metal whose normals are wrong fits worse than it would with true ones
POINT_WEIGHT, COLOUR_WEIGHT = 0.8, 0.5
COUPLING = 4.0  # weight of a surfel's links to its neighbours
NOISE_ERROR = 0.5  # robust error of a view that noise alone makes; the ratio of errors below it tells nothing


class AlbedoFit(NamedTuple):
    """Albedos of least error of P points.

    Attributes:
        albedo: (P, 3); it may lie outside 0..1.
        precision: (P, 3) curvature of half the squared error.
        error: (P,) robust error of a view, on average.
    """

    albedo: torch.Tensor
    precision: torch.Tensor
    error: torch.Tensor


class NearbyPoints(NamedTuple):
    """What the solver's points around N surfels are.

    Attributes:
        majority: (N,) share of metal among the MAJORITY_POINTS nearest, 0..1.
        share: (N,) share of metal among the ROUGHNESS_POINTS nearest, 0..1.
        roughness: (2, N) mean roughness of those that are no metal, and of those that are; 0 where there are none.
    """

    majority: torch.Tensor
    share: torch.Tensor
    roughness: torch.Tensor


def nearby_points(points: torch.Tensor, roughness: torch.Tensor, metallic: torch.Tensor, position: torch.Tensor) -> NearbyPoints:
    """Find what the solver's points around surfels are; a mean roughness over both sides of an edge would be that of neither.

    Args:
        points: (P, 3) world.
        roughness: (P,) of the points.
        metallic: (P,) of the points, 0 or 1.
        position: (N, 3) of the surfels, world.
    """
    around = nearest_neighbours(points, position, ROUGHNESS_POINTS)
    metal = metallic[around] > METALLIC_THRESHOLD
    alike = torch.stack([~metal, metal]).float()
    means = (alike * roughness[around]).sum(2) / alike.sum(2).clamp_min(1)
    return NearbyPoints(metal[:, :MAJORITY_POINTS].float().mean(1), metal.float().mean(1), means)


def drawn_metal(
    position: torch.Tensor, colour: torch.Tensor, nearby: NearbyPoints, dielectric: AlbedoFit, conductor: AlbedoFit
) -> torch.Tensor:
    """Draw the borders of metal among surfels.

    Args:
        position: (N, 3) of the surfels, world.
        colour: (N, 3) their mean linear radiance.
        nearby: the solver's points around them.
        dielectric: fits of all surfels as dielectrics.
        conductor: their fits as metal; those count that have metal nearby.

    Returns:
        (N,) bool.
    """
    possible, certain = nearby.share > 0, nearby.share >= 1
    if bool((possible == certain).all()):
        return certain
    rows = torch.nonzero(possible)[:, 0]
    neighbours, similarity = neighbourhood(position[rows], colour[rows])
    ratio = (dielectric.error[rows] + NOISE_ERROR).log() - (conductor.error[rows] + NOISE_ERROR).log()
    ratio = (similarity * ratio[neighbours]).sum(1)
    fixed = ratio + PRIOR + POINT_WEIGHT * (2 * nearby.majority[rows] - 1)
    metal = fixed > 0
    if bool(metal.any()):
        # Of the mean of the neighbours: a single surfel may look dark as metal because its normal is wrong.
        dark = too_dark((similarity[..., None] * conductor.albedo[rows][neighbours]).sum(1), metal)
        fixed = torch.where(dark, -MAX_EVIDENCE, fixed)
    for _ in range(COLOUR_PASSES):  # the colours of metal are known better when its borders are
        evidence = fixed + COLOUR_WEIGHT * colour_evidence(conductor.albedo[rows], dielectric.albedo[rows], metal)
        metal = least_cut(torch.where(certain[rows], MAX_EVIDENCE, evidence), neighbours, similarity, COUPLING)
    return torch.zeros_like(possible).index_copy(0, rows, metal)
