# SPDX-License-Identifier: GPL-3.0-or-later
"""Directions in which nothing stands before a patch of the image, as the rays tell that were traced from it and around it.

Measured, not proven: a patch of pixels may go without shadow rays in a direction only where several rays of its neighbourhood went
there and around, and none of them met anything.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch

from ..kernels.cpu.light_samples import survey_range
from ..machine.backend import by_warp
from .indirect_light import SecondaryRays

BINS = 16  # squares along a side of the octahedral map of directions
TILE = 4  # pixels
ENOUGH = 24  # rays of a neighbourhood of 3 x 3 tiles and 3 x 3 squares


@dataclass(frozen=True, eq=False)
class VisibilityCache:
    """Attributes: tile: (P,) int32 tile of each point. clear: (tiles, bins^2) uint8, 1 where nothing hides the light."""

    tile: torch.Tensor
    clear: torch.Tensor

    @classmethod
    def unknown(cls, count: int) -> VisibilityCache:
        """Of `count` points nothing is known, every ray has to be traced."""
        return cls(torch.zeros(count, dtype=torch.int32), torch.zeros(1, BINS * BINS, dtype=torch.uint8))

    @property
    def size(self) -> int:
        """Bytes in memory."""
        return self.tile.numel() * 4 + self.clear.numel()


def survey(direction: torch.Tensor, rays: SecondaryRays, index: torch.Tensor, width: int) -> VisibilityCache:
    """From P points' rays in directions (P, M, 3), at flat pixel indices (P,) of an image of a width."""
    if not len(index) or by_warp(index):  # a device traces its few rays sooner than it finds out which it could do without
        return VisibilityCache.unknown(len(index))
    down, across = index // width // TILE, index % width // TILE
    down, across = down - down.min(), across - across.min()
    rows, columns = int(down.max()) + 1, int(across.max()) + 1
    tile = (down * columns + across).int()
    seen, met = np.zeros((2, rows * columns, BINS * BINS), np.int32)
    survey_range(0, len(index), direction.numpy(), rays.terms.numpy(), rays.row.numpy(), tile.numpy(), BINS, seen, met)
    shape = (rows, columns, BINS, BINS)
    clear = (_around(seen.reshape(shape)) >= ENOUGH) & (_around(met.reshape(shape)) == 0)
    return VisibilityCache(tile, torch.from_numpy(clear.reshape(-1, BINS * BINS).astype(np.uint8)))


def _around(counts: np.ndarray) -> np.ndarray:
    """(R, C, B, B) sums over 3 x 3 tiles and, of directions, 3 x 3 squares; past an edge of the map it goes on mirrored."""
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
