# SPDX-License-Identifier: GPL-3.0-or-later
"""Initial Gaussians from dense stereo: surfels on the fused points, with the visual hull or random points where stereo found nothing."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.spatial import KDTree

from ...io.srgb import decode_srgb
from ...progress.protocol import Progress
from ...scene.dataset import Dataset
from ...scene.gaussians import Gaussians
from ...stereo.depth_map import DepthMap
from ...stereo.estimation import estimate_depth_maps
from ...stereo.fusion import OrientedPoints, fuse_points
from ...stereo.settings import StereoSettings
from .initialization import FAINT, OPACITY, observed_colour, point_spacing, random_points, spatial_order, surfels
from .visual_hull import VisualHull, visual_hull

SUPPORT = {True: 3, False: 2}  # views that must agree with a point, with masks and without: captures overlap less than turntables
SHARE = {True: 0.8, False: 0.65}  # largest share of the surfels that lie on stereo's points, with masks and without
FILLER = 0.1  # without masks: share of the surfels that are random points, for what stereo did not see
REACH = 0.03  # radii of the bound around stereo's points without other points; tolerance of the free-space test
SEEN_THROUGH = 2  # views whose depth lies behind a point, from which the point is in free space
RANGE = (0.6, 2.0)  # factors of the nearest and the farthest sparse points' depth between which stereo searches
VOXEL_ROUNDS = 12  # bisections of the voxel size that thins the points


def from_stereo(dataset: Dataset, count: int, seed: int, progress: Progress) -> Gaussians | None:
    """Place surfels on the points of dense stereo, and on the visual hull or at random where stereo says nothing.

    With masks, stereo searches inside the visual hull, and points of the hull are added where no stereo point is near and fewer than
    SEEN_THROUGH views look through them. Without masks, random points are added, likewise outside known free space.

    Args:
        dataset: training views, bound and sparse points.
        count: most surfels.
        seed: of stereo and of the samples.
        progress: receives the phase "stereo" and may cancel.

    Returns:
        The Gaussians, None where stereo found too few points to start on.

    Raises:
        Cancelled: the user stopped the work.
    """
    rng, masked, settings = np.random.default_rng(seed), dataset.has_alpha, StereoSettings()
    hull = visual_hull(dataset.train, dataset.bound) if masked else None
    nearest, farthest, initial = hull_bounds(dataset, hull) if hull is not None else depth_bounds(dataset)
    known = None if dataset.points is None or masked else dataset.points.position
    maps = estimate_depth_maps(dataset.train, nearest, farthest, known, settings, seed, progress, initial)
    points = fuse_points(maps, [view.colour for view in dataset.train], SUPPORT[masked], settings)
    if len(points.position) < SHARE[masked] * count / 10:
        return None
    points = thinned(points, int(SHARE[masked] * count))
    if hull is not None:
        other, other_normal, _ = hull.sample(count, rng)
    else:
        other, other_normal = random_points(dataset, int(FILLER * count), rng)
    reach = REACH * dataset.bound.radius
    keep = (KDTree(points.position).query(other)[0] > reach) & (views_through(other, maps, reach) < SEEN_THROUGH)
    other, other_normal = other[keep][: count - len(points.position)], other_normal[keep][: count - len(points.position)]
    place, normal = np.concatenate([points.position, other]), np.concatenate([points.normal, other_normal])
    colour = np.concatenate([decode_srgb(points.colour), observed_colour(dataset.train, other, other_normal)])
    opacity = np.repeat([OPACITY, OPACITY if masked else FAINT], [len(points.position), len(other)])
    order = spatial_order(place)
    place, normal, colour, opacity = place[order], normal[order], colour[order], opacity[order]
    return surfels(place, normal, colour, point_spacing(place, dataset.bound.radius), opacity)


def hull_bounds(dataset: Dataset, hull: VisualHull) -> tuple[list[np.ndarray], list[np.ndarray], list[np.ndarray]]:
    """Return the nearest and the farthest depth that stereo searches in each view, and depths to start near, all (H, W), from the hull."""
    found = hull.depths([view.camera for view in dataset.train])
    nearest = [np.where(enter > 0, enter - hull.step, 0).astype(np.float32) for enter, _ in found]
    farthest = [np.where(enter > 0, leave + hull.step, 0).astype(np.float32) for enter, leave in found]
    return nearest, farthest, [enter for enter, _ in found]


def depth_bounds(dataset: Dataset) -> tuple[list[float], list[float], None]:
    """Return the nearest and the farthest depth that stereo searches in each view: around its sparse points, or else the bound."""
    centre, radius = np.asarray(dataset.bound.centre), dataset.bound.radius
    nearest, farthest = [], []
    for view in dataset.train:
        depth = float(view.camera.project(centre[None])[1][0])
        low, high = max(depth - 1.1 * radius, 0.05 * abs(depth)), depth + 4 * radius
        if dataset.points is not None:
            pixel, depths = view.camera.project(dataset.points.position.astype(np.float64))
            inside = (depths > 0) & (pixel >= 0).all(1) & (pixel < (view.camera.width, view.camera.height)).all(1)
            if inside.sum() >= 20:
                low, high = np.quantile(depths[inside], [0.01, 0.99]) * RANGE
        nearest.append(float(low))
        farthest.append(float(high))
    return nearest, farthest, None


def thinned(points: OrientedPoints, count: int) -> OrientedPoints:
    """Average points in voxels, the smallest with which at most `count` points are left.

    Args:
        points: to thin; they are returned themselves where there are few enough.
        count: most points.
    """
    if len(points.position) <= count:
        return points
    low, high = 0.0, float(np.ptp(points.position, 0).max())
    for _ in range(VOXEL_ROUNDS):
        middle = 0.5 * (low + high) if low else high / 2
        if len(np.unique(_voxels(points.position, middle), axis=0)) > count:
            low = middle
        else:
            high = middle
    _, group = np.unique(_voxels(points.position, high), axis=0, return_inverse=True)
    group = group.reshape(-1)
    weight = np.bincount(group, points.support)
    average = lambda a: np.stack([np.bincount(group, points.support * c) / weight for c in a.T], 1)  # noqa: E731
    normal = average(points.normal)
    normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-9)
    arrays = (average(points.position), normal, average(points.colour))
    return OrientedPoints(*(a.astype(np.float32) for a in arrays), weight.astype(np.int32))


def _voxels(points: np.ndarray, size: float) -> np.ndarray:
    """Return the voxel indices (N, 3) of points (N, 3) for voxels of a size in world units."""
    return np.floor((points - points.min(0)) / size).astype(np.int32)


def views_through(points: np.ndarray, maps: Sequence[DepthMap], tolerance: float) -> np.ndarray:
    """Count the views that look through points: their supported depth at the point's pixel lies behind it.

    Args:
        points: (N, 3) world.
        maps: depth maps.
        tolerance: difference of depth, world units, up to which a depth is the point's own.

    Returns:
        (N,) number of views.
    """
    count = np.zeros(len(points), np.int32)
    for one in maps:
        pixel, depth = one.camera.project(points)
        column, row = np.floor(pixel).astype(int).T
        inside = (depth > 0) & (column >= 0) & (row >= 0) & (column < one.camera.width) & (row < one.camera.height)
        seen = np.where(one.support >= min(SUPPORT.values()), one.depth, 0)[row[inside], column[inside]]
        count[inside] += seen > depth[inside] + tolerance
    return count
