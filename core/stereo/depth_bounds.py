# SPDX-License-Identifier: GPL-3.0-or-later
"""Depths between which stereo searches in each view, from sparse points or from the object's bound."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ..scene.camera import Camera
from ..scene.dataset import Bound, PointCloud

DEPTH_RANGE = (0.6, 2.0)  # factors of the nearest and the farthest sparse points' depth between which stereo searches
MIN_POINTS = 20  # sparse points in a view from which they bound its depths


def depth_bounds(cameras: Sequence[Camera], points: PointCloud | None, bound: Bound) -> tuple[list[float], list[float]]:
    """Return the nearest and the farthest depth that stereo searches in each view: around its sparse points, or else the bound.

    Args:
        cameras: cameras of the views.
        points: sparse points, or None.
        bound: bounding sphere of the object, for views with few sparse points.
    """
    centre, radius = np.asarray(bound.centre), bound.radius
    nearest, farthest = [], []
    for camera in cameras:
        depth = float(camera.project(centre[None])[1][0])
        low, high = max(depth - 1.1 * radius, 0.05 * abs(depth)), depth + 4 * radius
        if points is not None:
            pixel, depths = camera.project(points.position.astype(np.float64))
            inside = camera.in_image(pixel, depths)
            if inside.sum() >= MIN_POINTS:
                low, high = np.quantile(depths[inside], [0.01, 0.99]) * DEPTH_RANGE
        nearest.append(float(low))
        farthest.append(float(high))
    return nearest, farthest
