# SPDX-License-Identifier: GPL-3.0-or-later
"""Reprojection error: how much a photograph differs from others that are warped into it through given depths.

Wrong depths show their errors as parallax. Views of a matt object agree at the right depth, whatever its colours are.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ..kernels.cpu.jit import kernel
from ..machine.thread_pool import run_jobs
from ..scene.dataset import View
from .consistency import apply, pixel_seeing
from .depth_map import camera_matrices


def reprojection_errors(
    views: Sequence[View], depths: Sequence[np.ndarray], sources: Sequence[Sequence[int]], relative: float
) -> list[np.ndarray]:
    """Compare every view with its sources at given depths.

    Args:
        views: photographs with their cameras.
        depths: (H, W) float32 planar depth of each view, 0 for none.
        sources: indices of the views that each view is compared with.
        relative: difference of depths, as a fraction, up to which a source sees the same point.

    Returns:
        For each view, (H, W) float32: the mean absolute difference of encoded colours over the sources that see the pixel's point; NaN
        where none does.
    """
    colours = [np.ascontiguousarray(view.colour, np.float32) for view in views]
    matrices = [camera_matrices(view.camera) for view in views]

    def compare(i: int) -> np.ndarray:
        total, count = np.zeros(depths[i].shape, np.float32), np.zeros(depths[i].shape, np.int32)
        for k in sources[i]:
            add_differences(matrices[i], matrices[k], depths[i], depths[k], colours[i], colours[k], relative, total, count)
        return np.where(count > 0, total / np.maximum(count, 1), np.float32(np.nan))

    return list(run_jobs(compare, [(i,) for i in range(len(views))]))


@kernel
def add_differences(own, its, depth, other_depth, colour, other_colour, relative, total, count):
    """Add a source's colour differences to `total` (H, W) and 1 to `count` where it sees the pixel's point.

    own and its: `camera_matrices` of the two views. Reference: `core.kernels.reference.reprojection`.
    """
    height, width = other_depth.shape
    for row in range(depth.shape[0]):
        for column in range(depth.shape[1]):
            d = float(depth[row, column])
            if d <= 0:
                continue
            x, y, z = apply(own[1], (column + 0.5) * d, (row + 0.5) * d, d)
            r, _, _ = pixel_seeing(its[0], x, y, z, other_depth, relative)
            if r < 0:
                continue
            a, b, far = apply(its[0], x, y, z)
            u, v = min(max(a / far - 0.5, 0.0), width - 1.001), min(max(b / far - 0.5, 0.0), height - 1.001)
            i, j = int(v), int(u)
            s, t = u - j, v - i
            difference = 0.0
            for c in range(3):
                upper = (1 - s) * other_colour[i, j, c] + s * other_colour[i, j + 1, c]
                lower = (1 - s) * other_colour[i + 1, j, c] + s * other_colour[i + 1, j + 1, c]
                difference += abs((1 - t) * upper + t * lower - colour[row, column, c])
            total[row, column] += difference / 3
            count[row, column] += 1
