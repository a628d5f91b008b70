# SPDX-License-Identifier: GPL-3.0-or-later
"""Free space: points that views look through, because what stereo found there lies behind them."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ...scene.camera import Camera
from ...stereo.depth_map import DepthMap
from ...stereo.fusion import OrientedPoints


def views_through(points: np.ndarray, maps: Sequence[DepthMap], tolerance: float, min_support: int) -> np.ndarray:
    """Count the views that look through points: the depth at the point's pixel lies behind it.

    Args:
        points: (N, 3) world.
        maps: depth maps.
        tolerance: difference of depth, world units, up to which a depth is the point's own.
        min_support: witnesses that must agree with a depth; 0: every depth counts, also what stereo guesses where there is no texture.

    Returns:
        (N,) number of views.
    """
    count = np.zeros(len(points), np.int32)
    for one in maps:
        inside, row, column, depth = _in_view(points, one.camera)
        seen = np.where(one.support >= min_support, one.depth, 0)[row, column]
        count[inside] += seen > depth + tolerance
    return count


def views_of(points: np.ndarray, cameras: Sequence[Camera], depths: Sequence[np.ndarray], tolerance: float) -> np.ndarray:
    """Count the views that see points of a surface: its depth at the point's pixel is the point's own.

    Args:
        points: (N, 3) world.
        cameras: cameras of the views.
        depths: (H, W) depth of the surface in each view; 0: none.
        tolerance: difference of depth, world units, up to which a depth is the point's own.

    Returns:
        (N,) number of views.
    """
    count = np.zeros(len(points), np.int32)
    for camera, image in zip(cameras, depths, strict=True):
        inside, row, column, depth = _in_view(points, camera)
        count[inside] += np.abs(image[row, column] - depth) <= tolerance
    return count


def in_free_space(
    points: OrientedPoints, maps: Sequence[DepthMap], nearest: Sequence[float], tolerance: float, min_support: int
) -> np.ndarray:
    """Find the points that cannot be there: as many views look through them as see them, or they are too near to a camera that sees them.

    Args:
        points: N points, fused from the maps.
        maps: depth maps.
        nearest: least depth of each map's view.
        tolerance: see `views_through`.
        min_support: see `views_through`.

    Returns:
        (N,) True for these points.
    """
    free = views_through(points.position, maps, tolerance, min_support) >= points.support
    for one, least in zip(maps, nearest, strict=True):
        inside, _, _, depth = _in_view(points.position, one.camera)
        free[inside] |= depth < least
    return free


def _in_view(points: np.ndarray, camera: Camera) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Return which points (N, 3) project into a camera's image, (N,) bool, and row, column and depth of these K, (K,) each."""
    pixel, depth = camera.project(points)
    inside = camera.in_image(pixel, depth)
    column, row = pixel[inside].astype(int).T
    return inside, row, column, depth[inside]
