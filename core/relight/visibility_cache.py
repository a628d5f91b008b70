# SPDX-License-Identifier: GPL-3.0-or-later
"""Visibility cache: directions that are unoccluded around a tile of the image, as found by the rays already traced from its neighbourhood.

A heuristic without guarantee: a tile skips shadow rays in a direction only if several rays of its neighbourhood were traced in this and
adjacent directions, and none of them met anything.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch

from ..kernels.cpu.light_samples import survey_range
from ..machine.backend import by_warp
from .indirect_light import SecondaryRays

BINS = 16  # cells along a side of the octahedral map of directions
TILE = 4  # pixels along a side
MIN_RAYS = 24  # rays required in a neighbourhood of 3 x 3 tiles and 3 x 3 cells


@dataclass(frozen=True, eq=False)
class VisibilityCache:
    """Unoccluded directions of each tile.

    Attributes:
        tile: (P,) int32 tile of each point.
        clear: (tiles, bins^2) uint8 over an octahedral map of directions, 1 where the light is unoccluded.
    """

    tile: torch.Tensor
    clear: torch.Tensor

    @classmethod
    def unknown(cls, count: int) -> VisibilityCache:
        """Return the cache of `count` points without any known direction: every ray has to be traced."""
        return cls(torch.zeros(count, dtype=torch.int32), torch.zeros(1, BINS * BINS, dtype=torch.uint8))

    @property
    def size(self) -> int:
        """Return the bytes in memory."""
        return self.tile.numel() * 4 + self.clear.numel()


def build_visibility_cache(direction: torch.Tensor, rays: SecondaryRays, index: torch.Tensor, width: int) -> VisibilityCache:
    """Build the cache from traced rays.

    Args:
        direction: (P, M, 3) unit directions of the rays, world.
        rays: the traced rays.
        index: (P,) flat pixel indices.
        width: width of the image in pixels.
    """
    if not len(index) or by_warp(index):  # on a GPU tracing every ray is faster than deciding which to skip
        return VisibilityCache.unknown(len(index))
    down, across = index // width // TILE, index % width // TILE
    down, across = down - down.min(), across - across.min()
    rows, columns = int(down.max()) + 1, int(across.max()) + 1
    tile = (down * columns + across).int()
    traced, hit = np.zeros((2, rows * columns, BINS * BINS), np.int32)
    survey_range(0, len(index), direction.numpy(), rays.terms.numpy(), rays.row.numpy(), tile.numpy(), BINS, traced, hit)
    shape = (rows, columns, BINS, BINS)
    enough = np.minimum(traced, MIN_RAYS).astype(np.int16).reshape(shape)  # small integers are summed faster
    met = (hit > 0).astype(np.uint8).reshape(shape)
    clear = (_neighbourhood_sums(enough) >= MIN_RAYS) & (_neighbourhood_sums(met) == 0)
    return VisibilityCache(tile, torch.from_numpy(clear.reshape(-1, BINS * BINS).astype(np.uint8)))


def _neighbourhood_sums(counts: np.ndarray) -> np.ndarray:
    """Sum counts (R, C, B, B) over 3 x 3 tiles and 3 x 3 cells of the octahedral map, which continues mirrored beyond its edges."""
    counts = np.concatenate([counts[:, :, :1, ::-1], counts, counts[:, :, -1:, ::-1]], 2)
    counts = np.concatenate([counts[:, :, ::-1, :1], counts, counts[:, :, ::-1, -1:]], 3)
    counts = counts[:, :, :-2] + counts[:, :, 1:-1] + counts[:, :, 2:]
    counts = counts[..., :-2] + counts[..., 1:-1] + counts[..., 2:]
    for axis in (0, 1):
        total = counts.copy()
        fore, aft = (slice(1, None), slice(None, -1))
        if axis == 0:
            total[fore] += counts[aft]
            total[aft] += counts[fore]
        else:
            total[:, fore] += counts[:, aft]
            total[:, aft] += counts[:, fore]
        counts = total
    return counts
