# SPDX-License-Identifier: GPL-3.0-or-later
"""Assignment of splats to tiles, in order of depth."""

from __future__ import annotations

import numpy as np

from ..constants import TILE
from .jit import kernel


@kernel
def depth_order(depth, box):
    """Return the indices (V,) of the V visible splats by rising depth: a stable radix sort of the float bits (depths are positive)."""
    keys = depth.view(np.uint32)
    count = 0
    for g in range(len(depth)):
        count += box[g, 0] <= box[g, 2]
    order, other = np.empty(count, np.int32), np.empty(count, np.int32)
    at = 0
    for g in range(len(depth)):
        if box[g, 0] <= box[g, 2]:
            order[at] = g
            at += 1
    for shift in (0, 11, 22):
        histogram = np.zeros(2049, np.int64)
        for i in range(count):
            histogram[((keys[order[i]] >> shift) & 2047) + 1] += 1
        for b in range(2048):
            histogram[b + 1] += histogram[b]
        for i in range(count):
            bucket = (keys[order[i]] >> shift) & 2047
            other[histogram[bucket]] = order[i]
            histogram[bucket] += 1
        order, other = other, order
    return order


@kernel
def count_tiles_range(begin, end, order, box, columns, count):
    """Count the splats of each tile in tile rows begin..end; count: (tiles,) int64, 0 before."""
    for g in order:
        for ty in range(max(box[g, 1] // TILE, begin), min(box[g, 3] // TILE, end - 1) + 1):
            for tx in range(box[g, 0] // TILE, box[g, 2] // TILE + 1):
                count[ty * columns + tx] += 1


@kernel
def fill_tiles_range(begin, end, order, box, columns, fill, entries):
    """Enter the splats of tile rows begin..end, nearest first; fill: (tiles,) where the next splat of each tile goes in `entries`."""
    for g in order:
        for ty in range(max(box[g, 1] // TILE, begin), min(box[g, 3] // TILE, end - 1) + 1):
            for tx in range(box[g, 0] // TILE, box[g, 2] // TILE + 1):
                t = ty * columns + tx
                entries[fill[t]] = g
                fill[t] += 1
