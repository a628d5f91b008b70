# SPDX-License-Identifier: GPL-3.0-or-later
"""Thinning of oriented points to a number that an optimisation can start with."""

from __future__ import annotations

import numpy as np

from ..scene.unique_rows import unique_rows
from ..scene.voxel_means import voxel_means
from .fusion import OrientedPoints

VOXEL_ROUNDS = 12  # bisections of the voxel size that thins the points


def thinned(points: OrientedPoints, count: int) -> OrientedPoints:
    """Average points in voxels, the smallest with which at most `count` points are left.

    Args:
        points: points to thin; they are returned themselves where there are few enough.
        count: most points.
    """
    if len(points.position) <= count:
        return points
    low, high = 0.0, float(np.ptp(points.position, 0).max())
    for _ in range(VOXEL_ROUNDS):
        middle = 0.5 * (low + high) if low else high / 2
        if len(unique_rows(_voxels(points.position, middle))) > count:
            low = middle
        else:
            high = middle
    means, support = voxel_means(_voxels(points.position, high), (points.position, points.normal, points.colour), points.support)
    means[1] /= np.maximum(np.linalg.norm(means[1], axis=1, keepdims=True), 1e-9)
    position, normal, colour = (mean.astype(np.float32) for mean in means)
    return OrientedPoints(position, normal, colour, support.astype(np.int32))


def _voxels(points: np.ndarray, size: float) -> np.ndarray:
    """Return the voxel indices (N, 3) of points (N, 3) for voxels of a size in world units."""
    return np.floor((points - points.min(0)) / size).astype(np.int32)
