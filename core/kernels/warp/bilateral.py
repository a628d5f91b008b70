# SPDX-License-Identifier: GPL-3.0-or-later
"""Cross-bilateral filter on the GPU, a thread per pixel; the weights are defined in core/kernels/cpu/bilateral.py."""

from functools import cache
from typing import Any

import torch
import warp as wp

from .runtime import launch

GUIDES = 7  # normal 3, depth, its slopes per pixel to the right and down, coverage


@cache
def _kernel(channels: int) -> Any:
    """Compile the filter for a number of channels."""
    Row = wp.types.vector(length=channels, dtype=wp.float32)
    count = channels

    @wp.kernel(module="unique")
    def mean(
        index: wp.array(dtype=wp.int64), width: int, height: int, guides: wp.array2d(dtype=float), spatial: wp.array2d(dtype=float),
        epsilon: float, doublings: int, values: wp.array2d(dtype=float), out: wp.array2d(dtype=float),
    ):  # fmt: skip
        """Filter values (H W, C) by guides (H W, GUIDES), both 0 where empty, to out (P, C) at the pixels `index`."""
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
                    neighbour = y * width + x
                    coverage = guides[neighbour, 6]
                    if coverage > 0.0:
                        cosine = wp.clamp(nx * guides[neighbour, 0] + ny * guides[neighbour, 1] + nz * guides[neighbour, 2], 0.0, 1.0)
                        for _ in range(doublings):
                            cosine = cosine * cosine
                        step = wp.abs(right * float(dx) + down * float(dy)) + epsilon
                        weight = cosine * wp.exp(-wp.abs(guides[neighbour, 3] - z) / step) * coverage * spatial[dy + reach, dx + reach]
                        total += weight
                        for j in range(count):
                            acc[j] += weight * values[neighbour, j]
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
    """Filter values of an image's pixels over their neighbours.

    Args:
        index: (P,) int64 flat indices of the pixels.
        width: width of the image in pixels.
        height: height of the image in pixels.
        guides: (P, GUIDES) normal, depth, its slopes, coverage.
        spatial: (T, T) spatial weights, T odd.
        epsilon: depth tolerance, scene units.
        doublings: the exponent of the normals' cosine is 2^doublings.
        values: (P, C) values.

    Returns:
        (P, C) weighted means.
    """
    scattered = [v.new_zeros(width * height, v.shape[1]).index_copy(0, index, v) for v in (guides, values)]
    out = torch.empty_like(values)
    if len(index):
        launch(_kernel(values.shape[1]), len(index), index, width, height, scattered[0], spatial, epsilon, doublings, scattered[1], out)
    return out
