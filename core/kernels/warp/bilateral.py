# SPDX-License-Identifier: GPL-3.0-or-later
"""The cross-bilateral filter on the device, a thread for each pixel; the weights are those of core/kernels/cpu/bilateral.py."""

from functools import cache
from typing import Any

import torch
import warp as wp

from .runtime import launch

GUIDES = 7  # normal 3, depth, its slopes to the right and down, coverage


@cache
def _kernel(channels: int) -> Any:
    Row = wp.types.vector(length=channels, dtype=wp.float32)
    count = channels

    @wp.kernel(module="unique")
    def mean(
        index: wp.array(dtype=wp.int64), width: int, height: int, guides: wp.array2d(dtype=float), spatial: wp.array2d(dtype=float),
        epsilon: float, doublings: int, values: wp.array2d(dtype=float), out: wp.array2d(dtype=float),
    ):  # fmt: skip
        """guides (H W, GUIDES) and values (H W, C), 0 where nothing is -> out (P, C) at the pixels `index`."""
        p = wp.tid()
        here = int(index[p])
        row, column = here / width, here % width
        reach = spatial.shape[0] / 2
        nx, ny, nz, z = guides[here, 0], guides[here, 1], guides[here, 2], guides[here, 3]
        right, down = guides[here, 4], guides[here, 5]
        acc, total = Row(0.0), float(0.0)
        for dy in range(-reach, reach + 1):
            for dx in range(-reach, reach + 1):
                y, x = row + dy, column + dx
                if y >= 0 and y < height and x >= 0 and x < width:
                    there = y * width + x
                    coverage = guides[there, 6]
                    if coverage > 0.0:
                        cosine = wp.clamp(nx * guides[there, 0] + ny * guides[there, 1] + nz * guides[there, 2], 0.0, 1.0)
                        for _ in range(doublings):
                            cosine = cosine * cosine
                        step = wp.abs(right * float(dx) + down * float(dy)) + epsilon
                        weight = cosine * wp.exp(-wp.abs(guides[there, 3] - z) / step) * coverage * spatial[dy + reach, dx + reach]
                        total += weight
                        for j in range(count):
                            acc[j] += weight * values[there, j]
        scale = float(0.0)
        if total > 0.0:
            scale = 1.0 / total
        for j in range(count):
            out[p, j] = acc[j] * scale

    return mean


def filtered(
    index: torch.Tensor, width: int, height: int, guides: torch.Tensor, spatial: torch.Tensor, epsilon: float, doublings: int,
    values: torch.Tensor,
) -> torch.Tensor:  # fmt: skip
    """(P, C): means of the values (P, C) of an image's pixels `index` (P,) over their neighbours; guides: (P, GUIDES)."""
    scattered = [v.new_zeros(width * height, v.shape[1]).index_copy(0, index, v) for v in (guides, values)]
    out = torch.empty_like(values)
    if len(index):
        launch(_kernel(values.shape[1]), len(index), index, width, height, scattered[0], spatial, epsilon, doublings, scattered[1], out)
    return out
