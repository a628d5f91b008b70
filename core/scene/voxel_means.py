# SPDX-License-Identifier: GPL-3.0-or-later
"""Means over the points of each voxel."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from .unique_rows import unique_rows


def voxel_means(cells: np.ndarray, values: Sequence[np.ndarray], weight: np.ndarray | None = None) -> tuple[list[np.ndarray], np.ndarray]:
    """Average values over the points in each voxel.

    Args:
        cells: (N, 3) integers, N > 0, the voxel of each point.
        values: arrays (N, C) of the points.
        weight: (N,) of the points, with a positive sum in each voxel; None: all count alike.

    Returns:
        The means (M, C) float64 of each array in the M voxels with points, by ascending voxel, and the sums of weights (M,).
    """
    _, group = unique_rows(cells, return_inverse=True)
    total = np.bincount(group, weight)
    weighted = [value if weight is None else weight[:, None] * value for value in values]
    return [np.stack([np.bincount(group, column) / total for column in value.T], 1) for value in weighted], total
