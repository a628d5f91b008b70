# SPDX-License-Identifier: GPL-3.0-or-later
"""Assignment of splats to tiles, in order of depth."""

from __future__ import annotations

import numpy as np

from ...machine.thread_pool import balanced_ranges, run_ranges, thread_count
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
def _count_tiles(order, box, columns, rows):
    """Return the tiles that each splat of `order` touches, (V, 4) x0 y0 x1 y1 inclusive, and the number of splats of each tile.

    The numbers are the double sums of steps at the corners of the splats' rectangles: four additions each, whatever its size.
    """
    spans, steps = np.empty((len(order), 4), np.int32), np.zeros((rows + 1, columns + 1), np.int64)
    for i in range(len(order)):
        g = order[i]
        x0, y0, x1, y1 = box[g, 0] // TILE, box[g, 1] // TILE, box[g, 2] // TILE, box[g, 3] // TILE
        spans[i, 0], spans[i, 1], spans[i, 2], spans[i, 3] = x0, y0, x1, y1
        steps[y0, x0] += 1
        steps[y0, x1 + 1] -= 1
        steps[y1 + 1, x0] -= 1
        steps[y1 + 1, x1 + 1] += 1
    for y in range(rows):
        for x in range(columns):
            left = steps[y, x - 1] if x > 0 else 0
            above = steps[y - 1, x] - (steps[y - 1, x - 1] if x > 0 else 0) if y > 0 else 0
            steps[y, x] += left + above
    return spans, steps[:rows, :columns].copy()


@kernel
def _fill_tiles_range(begin, end, order, spans, start, columns, entries):
    """Write the splats of the tiles in tile rows begin..end to `entries`, in the order of `order`."""
    first = begin * columns
    fill = start[first : end * columns].copy()
    for i in range(len(order)):
        for ty in range(max(spans[i, 1], begin), min(spans[i, 3], end - 1) + 1):
            for t in range(ty * columns + spans[i, 0], ty * columns + spans[i, 2] + 1):
                entries[fill[t - first]] = order[i]
                fill[t - first] += 1


def bin_tiles(order: np.ndarray, box: np.ndarray, columns: int, rows: int) -> tuple[np.ndarray, np.ndarray]:
    """Return tile lists: the splats of tile t are entries[start[t] : start[t + 1]], nearest first.

    Args:
        order: (V,) int32 visible splats, nearest first.
        box: (N, 4) pixel boxes, inclusive.
        columns: tiles along a row of the image.
        rows: tiles along a column.

    Returns:
        start (columns * rows + 1,) int64, and entries (E,) int32.
    """
    spans, count = _count_tiles(order, box, columns, rows)
    start = np.concatenate([np.zeros(1, np.int64), np.cumsum(count)])
    entries = np.empty(start[-1], np.int32)
    run_ranges(_fill_tiles_range, balanced_ranges(count.sum(1), thread_count()), order, spans, start, columns, entries)
    return start, entries
