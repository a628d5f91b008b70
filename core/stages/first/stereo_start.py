# SPDX-License-Identifier: GPL-3.0-or-later
"""Start on dense stereo: surfels on the points that stereo found, and on others where it found none."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.spatial import KDTree

from ...io.srgb import decode_srgb
from ...scene.dataset import Dataset
from ...scene.gaussians import Gaussians
from ...stereo.depth_map import DepthMap
from ...stereo.fusion import OrientedPoints
from .free_space import views_through
from .initialization import OPACITY, SURFACE_SPREAD, observed_colour, spatial_order, surface_spacing, surfels

MIN_SUPPORT_MASKED, MIN_SUPPORT_UNMASKED = 3, 2  # views that must agree with a point: captures overlap less than turntables
CLEARANCE_RADII = 0.03  # radii of the bound around stereo's points without other points; tolerance of the free-space test
MIN_VIEWS_THROUGH = 2  # views whose depth lies behind a point, from which the point is in free space


@dataclass(frozen=True, eq=False)
class StereoStart:
    """Initial Gaussians that dense stereo contributed to.

    Attributes:
        name: name of the start, in messages.
        gaussians: initial Gaussians on stereo's points and elsewhere.
        share: fraction of them that lie on stereo's points.
        maps: depth map of each training view.
        opened: makes the same start with open gaps, see `MaskedStarts`, or None where it is almost the same; None without masks.
        vessel: makes the same start with the hollow of a vessel whose mouths have at least a relative depth, see `find_vessel`, or None
            where there is none; None without masks.
    """

    name: str
    gaussians: Gaussians
    share: float
    maps: list[DepthMap]
    opened: Callable[[], StereoStart | None] | None = None
    vessel: Callable[[float], StereoStart | None] | None = None


@dataclass(frozen=True, eq=False)
class FoundByStereo:
    """Depth maps and fused points of stereo."""

    maps: list[DepthMap]
    points: OrientedPoints


def joined_surfels(
    dataset: Dataset, points: OrientedPoints, other: np.ndarray, other_normal: np.ndarray, opacity: float
) -> tuple[Gaussians, float]:
    """Make surfels in spatial order of stereo's points, and of other points (N, 3) with normals (N, 3) and an opacity.

    Returns:
        The surfels, and the fraction of them that lie on stereo's points.
    """
    place, normal = np.concatenate([points.position, other]), np.concatenate([points.normal, other_normal])
    colour = np.concatenate([decode_srgb(points.colour), observed_colour(dataset.train, other, other_normal)])
    opacities = np.repeat([OPACITY, opacity], [len(points.position), len(other)])
    order, scale = spatial_order(place), SURFACE_SPREAD * surface_spacing(place, dataset.bound.radius)
    gaussians = surfels(place[order], normal[order], colour[order], scale[order], opacities[order])
    return gaussians, len(points.position) / max(len(place), 1)


def unexplained(others: np.ndarray, points: OrientedPoints, maps: list[DepthMap], reach: float) -> np.ndarray:
    """Return (N,) True for points that none of stereo's is near and that few views look through.

    Args:
        others: (N, 3).
        points: of stereo.
        maps: depth maps of stereo.
        reach: distance up to which a point is near, and tolerance of the free-space test, world units.
    """
    return apart(others, points, reach) & (views_through(others, maps, reach, MIN_SUPPORT_UNMASKED) < MIN_VIEWS_THROUGH)


def apart(others: np.ndarray, points: OrientedPoints, reach: float) -> np.ndarray:
    """Return (N,) True for points that are far from all of stereo's.

    Args:
        others: (N, 3).
        points: of stereo.
        reach: distance from which they are far, world units.
    """
    if not len(points.position):
        return np.ones(len(others), bool)
    return KDTree(points.position).query(others, workers=-1)[0] > reach
