# SPDX-License-Identifier: GPL-3.0-or-later
"""Hull surface: where the surfels of a region of virtual images go, on the surface of the hull carved around it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial import KDTree

from ...scene.dataset import Dataset
from ...scene.gaussians import Gaussians, quaternion_to
from .carved_hull import CarvedHull, carve_hull
from .layered_regions import SPACING_NEIGHBOURS
from .start import Start

MIN_DEPTH = 1.0  # spacings of the points below the carved hull, median, from which they are moved onto it
REACH = 0.1  # radii of the bound around a region's points within which the hull's surface is the region's
BESIDE = 0.03  # radii of the bound around the other points within which it is theirs
# Area of this surface over that of as many surfels as the region has, below which they stay: three parts of metal have .4 to .45, an arm
# ring whose hull is mostly that of the arm beside it .01.
MIN_COVERAGE = 0.2


@dataclass(frozen=True, eq=False)
class HullSurface:
    """Surface for a region's surfels.

    Attributes:
        region: (N,) bool, the region among the surfels of the start.
        place: (K, 3) points of the surface, world.
        normal: (K, 3) unit, outwards.
    """

    region: np.ndarray
    place: np.ndarray
    normal: np.ndarray


def hull_surface(start: Start, dataset: Dataset, region: np.ndarray) -> HullSurface | None:
    """Carve the hull of a region of virtual images, and return its surface.

    None where the points lie on the surface already, or where too little of it belongs to the region (MIN_COVERAGE).

    Args:
        start: what the first stage starts with; it has stereo's depths.
        dataset: training views with masks, and the bound.
        region: (N,) bool of the start's surfels.
    """
    assert start.anchors is not None
    points, radius = start.points(), dataset.bound.radius
    hull = carve_hull(dataset.train, start.anchors, points[region], radius)
    spacing = float(np.median(KDTree(points).query(points, SPACING_NEIGHBOURS + 1, workers=-1)[0][:, SPACING_NEIGHBOURS]))
    if not hull.has_surface or np.median(hull.depth(points[region])) < MIN_DEPTH * spacing:
        return None
    place, normal = _own_surface(hull, points[region], points[~region], radius)
    covers = len(place) * hull.side**2 > MIN_COVERAGE * region.sum() * spacing**2
    return HullSurface(region, place, normal) if covers else None


def _own_surface(hull: CarvedHull, points: np.ndarray, others: np.ndarray, radius: float) -> tuple[np.ndarray, np.ndarray]:
    """Return the part of a hull's surface, points and normals (K, 3), that belongs to a region's points (M, 3) and not to others (N, 3)."""
    place, normal = hull.surface()
    own = KDTree(points).query(place, workers=-1)[0] < REACH * radius
    own &= KDTree(others).query(place, workers=-1)[0] > BESIDE * radius
    return place[own], normal[own]


def moved_onto_hulls(gaussians: Gaussians, surfaces: Sequence[HullSurface]) -> Gaussians:
    """Return Gaussians of which those of regions lie evenly on their surfaces, and face outwards.

    Args:
        gaussians: N surfels.
        surfaces: of regions that share no surfel.
    """
    position, quaternion = gaussians.position.clone(), gaussians.quaternion.clone()
    for one in surfaces:
        held, count = np.flatnonzero(one.region), int(one.region.sum())
        chosen = np.arange(count) * len(one.place) // count
        position[:, held] = position.new_tensor(one.place[chosen].T)
        quaternion[:, held] = quaternion_to(position.new_tensor(one.normal[chosen].T))
    return replace(gaussians, position=position, quaternion=quaternion)
