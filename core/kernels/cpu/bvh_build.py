# SPDX-License-Identifier: GPL-3.0-or-later
"""Construction of the bounding volume hierarchy: binned surface area heuristic over boxes of surfels; used by core/kernels/cpu/bvh.py.

A box is 8 floats: low x y z, unused, -high x y z, unused, so that a union is one minimum.
"""

from __future__ import annotations

import math

import numpy as np

from .jit import helper, kernel
from .simd import load, minimum, splat, store

_BINS = 16  # per axis


@helper
def grow(boxes, at, other, g):
    """Extend box `at` of `boxes` to contain box `g` of `other`."""
    store(boxes, at * 8, minimum(load(boxes, at * 8), load(other, g * 8)))


@helper
def _area(box, at):
    """Return half the surface area of box `at`."""
    x, y, z = box[at * 8] + box[at * 8 + 4], box[at * 8 + 1] + box[at * 8 + 5], box[at * 8 + 2] + box[at * 8 + 6]
    return x * y + y * z + z * x


@helper
def _bound(order, begin, end, boxes, box):
    """Write the box around surfels order[begin:end] to `box` (8,)."""
    hull = splat(np.float32(math.inf))
    for i in range(begin, end):
        hull = minimum(hull, load(boxes, order[i] * 8))
    store(box, 0, hull)


@helper
def _bin(middle, g, axis, start, step):
    """Return the bin of surfel g's centre along an axis."""
    return min(max(int((middle[g * 8 + axis] - start) * step), 0), _BINS - 1)


@helper
def _cheapest(axis, count, bins, fill, prices, box):
    """Return the bin of one axis at which the second half best starts, and the cost of that split."""
    first = axis * _BINS
    store(box, 0, splat(np.float32(math.inf)))
    seen, best, least = 0, 0, np.float32(math.inf)
    for b in range(_BINS - 1):
        grow(box, 0, bins, first + b)
        seen += fill[first + b]
        prices[b] = _area(box, 0) * np.float32((seen + 7) // 8)
    store(box, 0, splat(np.float32(math.inf)))
    seen = 0
    for b in range(_BINS - 1, 0, -1):
        grow(box, 0, bins, first + b)
        seen += fill[first + b]
        if 0 < seen < count:
            total = prices[b - 1] + _area(box, 0) * np.float32((seen + 7) // 8)
            if total < least:
                best, least = b, total
    return best, least


@helper
def _split(order, begin, end, boxes, middle, bins, fill, prices, box):
    """Partition order[begin:end] in place where the surface area heuristic costs least; return the start of the second half."""
    _bound(order, begin, end, middle, box)
    x, y, z = box[0], box[1], box[2]
    scale = np.float32(_BINS * 0.9999)
    tiny = np.float32(1e-30)
    sx, sy, sz = scale / max(-box[4] - x, tiny), scale / max(-box[5] - y, tiny), scale / max(-box[6] - z, tiny)
    fill[:] = 0
    for b in range(3 * _BINS):
        store(bins, b * 8, splat(np.float32(math.inf)))
    for i in range(begin, end):
        g = order[i]
        bx, by, bz = _bin(middle, g, 0, x, sx), _bin(middle, g, 1, y, sy) + _BINS, _bin(middle, g, 2, z, sz) + 2 * _BINS
        fill[bx] += 1
        fill[by] += 1
        fill[bz] += 1
        grow(bins, bx, boxes, g)
        grow(bins, by, boxes, g)
        grow(bins, bz, boxes, g)
    axis, best, least = 0, 0, np.float32(math.inf)
    for a in range(3):
        b, price = _cheapest(a, end - begin, bins, fill, prices, box)
        if price < least:
            axis, best, least = a, b, price
    start, step = (x, sx) if axis == 0 else ((y, sy) if axis == 1 else (z, sz))
    left, right = begin, end - 1
    while left <= right:
        g = order[left]
        if _bin(middle, g, axis, start, step) < best:
            left += 1
        else:
            order[left], order[right] = order[right], g
            right -= 1
    return left if begin < left < end else (begin + end) // 2


@kernel
def build_nodes(order, boxes, middle):
    """Sort `order` (M,) into leaves; return children (nodes, 8), leaf ranges in `order` (leaves, 2) and the depth of the tree.

    A child is the number of a later node, ~leaf, or the number of its own node where there is no child.
    """
    m = len(order)
    child = np.empty((m + 1, 8), np.int32)
    leaves = np.empty((m + 1, 2), np.int32)
    begins, ends, levels = np.empty(m + 1, np.int32), np.empty(m + 1, np.int32), np.empty(m + 1, np.int32)
    bins, fill, prices = np.empty(3 * _BINS * 8, np.float32), np.empty(3 * _BINS, np.int32), np.empty(_BINS, np.float32)
    box, cost = np.empty(8, np.float32), np.empty(8, np.float32)
    part = np.empty((8, 2), np.int32)
    begins[0], ends[0], levels[0] = 0, m, 1
    nodes, leaf_count, node = 1, 0, 0
    while node < nodes:
        part[0, 0], part[0, 1], cost[0], parts = begins[node], ends[node], np.float32(math.inf), 1
        while parts < 8:
            dearest, most = -1, np.float32(-1.0)
            for p in range(parts):
                if part[p, 1] - part[p, 0] > 8 and cost[p] > most:
                    dearest, most = p, cost[p]
            if dearest < 0:
                break
            begin, end = part[dearest, 0], part[dearest, 1]
            half = _split(order, begin, end, boxes, middle, bins, fill, prices, box)
            part[dearest, 1], part[parts, 0], part[parts, 1] = half, half, end
            for p in (dearest, parts):
                _bound(order, part[p, 0], part[p, 1], boxes, box)
                cost[p] = _area(box, 0) * np.float32(part[p, 1] - part[p, 0])  # rays that hit the box times the surfels they then test
            parts += 1
        for p in range(8):
            if p >= parts:
                child[node, p] = node
            elif part[p, 1] - part[p, 0] <= 8:
                leaves[leaf_count, 0], leaves[leaf_count, 1] = part[p, 0], part[p, 1]
                child[node, p] = ~leaf_count
                leaf_count += 1
            else:
                begins[nodes], ends[nodes], levels[nodes] = part[p, 0], part[p, 1], levels[node] + 1
                child[node, p] = nodes
                nodes += 1
        node += 1
    return child[:nodes].copy(), leaves[:leaf_count].copy(), levels[nodes - 1]
