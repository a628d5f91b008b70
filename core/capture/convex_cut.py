# SPDX-License-Identifier: GPL-3.0-or-later
"""Minimum cut of an image by convex relaxation: the continuous form of a graph cut, without its preference for axis-parallel edges."""

from __future__ import annotations

import numpy as np

from ..kernels.cpu.jit import kernel

STEP = 0.35  # of the primal and the dual variable: their product must stay below 1/8


def minimum_cut(cost: np.ndarray, weight: np.ndarray, start: np.ndarray, iterations: int) -> np.ndarray:
    """Minimise the sum of u cost + weight |grad u| over u in 0..1 by a primal-dual method (Chan et al. 2006; Chambolle and Pock 2011).

    Any threshold of an exact minimiser is a minimum cut, so the result is nearly binary; cut it at 0.5.

    Args:
        cost: (H, W) float32 cost of the foreground minus that of the background.
        weight: (H, W) float32 cost of a unit of edge length at each pixel, >= 0.
        start: (H, W) float32 in 0..1 where the iterations begin.
        iterations: number of them.

    Returns:
        u (H, W) float32.
    """
    u = np.array(start, np.float32)
    ahead, across, down = u.copy(), np.zeros_like(u), np.zeros_like(u)
    _iterate(np.ascontiguousarray(cost, np.float32), np.ascontiguousarray(weight, np.float32), u, ahead, across, down, iterations)
    return u


@kernel
def _iterate(cost, weight, u, ahead, across, down, iterations):
    """Run the iterations in place; ahead: the extrapolated u, across and down: the dual field, all (H, W)."""
    height, width = u.shape
    step = np.float32(STEP)
    for _ in range(iterations):
        for i in range(height):
            for j in range(width):
                value = ahead[i, j]
                x = across[i, j] + (step * (ahead[i, j + 1] - value) if j + 1 < width else np.float32(0))
                y = down[i, j] + (step * (ahead[i + 1, j] - value) if i + 1 < height else np.float32(0))
                length, most = np.sqrt(x * x + y * y), weight[i, j]
                scale = most / length if length > most else np.float32(1)
                across[i, j], down[i, j] = scale * x, scale * y
        for i in range(height):
            for j in range(width):
                divergence = across[i, j] + down[i, j]
                if j > 0:
                    divergence -= across[i, j - 1]
                if i > 0:
                    divergence -= down[i - 1, j]
                before = u[i, j]
                after = min(max(before + step * (divergence - cost[i, j]), np.float32(0)), np.float32(1))
                u[i, j] = after
                ahead[i, j] = after + after - before
