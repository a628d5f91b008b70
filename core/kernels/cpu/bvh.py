# SPDX-License-Identifier: GPL-3.0-or-later
"""An 8-wide bounding volume hierarchy over 2D Gaussians, each bounded where its alpha falls below ALPHA_MIN.

A node holds the boxes of up to 8 children side by side, a leaf up to 8 surfels, so that one vector operation tests them all.
Splits follow the surface area heuristic in bins, a leaf costing the same however full it is.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import torch

from ..constants import ALPHA_MIN, AXIS_U, AXIS_V, CUT, NORMAL, OPACITY, SCALE_RANGE, SCALE_U, SCALE_V, SURFEL_RECORD
from .jit import kernel
from .simd import load, minimum, splat, store

LEAF = 14 * 8  # floats of a leaf: the record up to CUT, 8 surfels to each
NODE = 6 * 8  # floats of a node: low x y z, high x y z, 8 children to each
_BINS = 16
_PAD = np.float32(1e-6)  # boxes grow by this share of their position, ten times that of their size: rounding must not lose a hit


@kernel
def describe_surfels(position, quaternion, log_scale, opacity, n, record, box, middle):
    """Records (N, SURFEL_RECORD), boxes and centres (N x 8,) of all surfels; CUT is -1 and the box empty where nothing can be hit."""
    box[:] = middle[:] = np.float32(0.0)
    for i in range(n):
        w, x, y, z = quaternion[i], quaternion[n + i], quaternion[2 * n + i], quaternion[3 * n + i]
        inv = np.float32(1.0) / np.float32(math.sqrt(max(w * w + x * x + y * y + z * z, np.float32(1e-20))))
        w, x, y, z = w * inv, x * inv, y * inv, z * inv
        u = (1 - 2 * (y * y + z * z), 2 * (x * y + w * z), 2 * (x * z - w * y))
        v = (2 * (x * y - w * z), 1 - 2 * (x * x + z * z), 2 * (y * z + w * x))
        normal = (2 * (x * z + w * y), 2 * (y * z - w * x), 1 - 2 * (x * x + y * y))
        su, sv = np.float32(math.exp(log_scale[i])), np.float32(math.exp(log_scale[n + i]))
        alpha = np.float32(1.0) / (np.float32(1.0) + np.float32(math.exp(-opacity[i])))
        valid = alpha > ALPHA_MIN and SCALE_RANGE[0] < su < SCALE_RANGE[1] and SCALE_RANGE[0] < sv < SCALE_RANGE[1]
        for axis in range(3):
            valid = valid and abs(position[axis * n + i]) < SCALE_RANGE[1] and abs(normal[axis]) < 2
        record[i, OPACITY] = alpha
        record[i, CUT] = np.float32(2.0 * math.log(alpha / ALPHA_MIN)) if valid else np.float32(-1.0)
        record[i, SCALE_U], record[i, SCALE_V] = su, sv
        radius = math.sqrt(max(record[i, CUT], np.float32(0.0)))
        half = radius * max(su, sv)
        for axis in range(3):
            c = position[axis * n + i]
            record[i, axis], record[i, NORMAL + axis] = c, normal[axis]
            record[i, AXIS_U + axis], record[i, AXIS_V + axis] = u[axis] / su, v[axis] / sv
            reach = radius * math.sqrt((su * u[axis]) ** 2 + (sv * v[axis]) ** 2) + _PAD * (abs(c) + 10 * half)
            box[i * 8 + axis] = c - reach if valid else np.float32(math.inf)
            box[i * 8 + 4 + axis] = -c - reach if valid else np.float32(math.inf)
            middle[i * 8 + axis], middle[i * 8 + 4 + axis] = c, -c


@kernel
def _grow(boxes, at, other, g):
    """Make box `at` of `boxes` hold box `g` of `other`."""
    store(boxes, at * 8, minimum(load(boxes, at * 8), load(other, g * 8)))


@kernel
def _area(box, at):
    x, y, z = box[at * 8] + box[at * 8 + 4], box[at * 8 + 1] + box[at * 8 + 5], box[at * 8 + 2] + box[at * 8 + 6]
    return x * y + y * z + z * x


@kernel
def _bound(order, begin, end, boxes, box):
    """The box around those of order[begin:end] -> box (8,)."""
    hull = splat(np.float32(math.inf))
    for i in range(begin, end):
        hull = minimum(hull, load(boxes, order[i] * 8))
    store(box, 0, hull)


@kernel
def _bin(middle, g, axis, start, step):
    return min(max(int((middle[g * 8 + axis] - start) * step), 0), _BINS - 1)


@kernel
def _cheapest(axis, count, bins, fill, prices, box):
    """The best bin of one axis to start the second half with, and its cost."""
    first = axis * _BINS
    store(box, 0, splat(np.float32(math.inf)))
    seen, best, least = 0, 0, np.float32(math.inf)
    for b in range(_BINS - 1):
        _grow(box, 0, bins, first + b)
        seen += fill[first + b]
        prices[b] = _area(box, 0) * np.float32((seen + 7) // 8)
    store(box, 0, splat(np.float32(math.inf)))
    seen = 0
    for b in range(_BINS - 1, 0, -1):
        _grow(box, 0, bins, first + b)
        seen += fill[first + b]
        if 0 < seen < count:
            total = prices[b - 1] + _area(box, 0) * np.float32((seen + 7) // 8)
            if total < least:
                best, least = b, total
    return best, least


@kernel
def _split(order, begin, end, boxes, middle, bins, fill, prices, box):
    """Part order[begin:end] in two where that costs rays least; returns where the second half starts."""
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
        _grow(bins, bx, boxes, g)
        _grow(bins, by, boxes, g)
        _grow(bins, bz, boxes, g)
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
    """Sort `order` (M,) into leaves. Returns children (nodes, 8), leaf ranges in `order` (leaves, 2) and the tree's depth.

    A child is a later node's number, ~leaf, or its own node's number where there is none.
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
                cost[p] = _area(box, 0) * np.float32(part[p, 1] - part[p, 0])  # rays that come by times what they meet
            parts += 1
        for p in range(8):
            if p >= parts:
                child[node, p] = node
            elif part[p, 1] - part[p, 0] <= 8:
                leaves[leaf_count] = part[p]
                child[node, p] = ~leaf_count
                leaf_count += 1
            else:
                begins[nodes], ends[nodes], levels[nodes] = part[p, 0], part[p, 1], levels[node] + 1
                child[node, p] = nodes
                nodes += 1
        node += 1
    return child[:nodes].copy(), leaves[:leaf_count].copy(), levels[nodes - 1]


@kernel
def fill_leaves(index, record, leaf):
    """Copy the records of `index` (leaves x 8, -1 where empty) into leaves, 8 surfels side by side."""
    for i in range(len(index)):
        at = (i // 8) * LEAF + i % 8
        for j in range(LEAF // 8):
            leaf[at + j * 8] = record[index[i], j] if index[i] >= 0 else np.float32(0.0)
        if index[i] < 0:
            leaf[at + CUT * 8] = np.float32(-1.0)


@kernel
def fill_nodes(child, index, boxes, node):
    """Boxes of all children, from the last node to the first."""
    box = np.empty(8, np.float32)
    for i in range(len(child) - 1, -1, -1):
        for lane in range(8):
            c = child[i, lane]
            store(box, 0, splat(np.float32(math.inf)))
            if c < 0:
                for j in range(~c * 8, ~c * 8 + 8):
                    if index[j] >= 0:
                        _grow(box, 0, boxes, index[j])
            elif c != i:
                for axis in range(3):
                    for j in range(8):
                        box[axis] = min(box[axis], node[c * NODE + axis * 8 + j])
                        box[4 + axis] = min(box[4 + axis], -node[c * NODE + 24 + axis * 8 + j])
            for axis in range(3):
                node[i * NODE + axis * 8 + lane] = box[axis]
                node[i * NODE + 24 + axis * 8 + lane] = -box[4 + axis]


def aligned(floats: int) -> np.ndarray:
    """So many floats from the start of a cache line on: vectors that lie across two lines are loaded twice."""
    memory = np.empty(floats + 16, np.float32)
    first = -memory.ctypes.data % 64 // 4
    return memory[first : first + floats]


def flat(tensor: torch.Tensor) -> np.ndarray:
    """A tensor's values as a contiguous 1-D float32 array, without its history."""
    return tensor.detach().contiguous().view(-1).numpy()


@dataclass
class SurfelTree:
    """N Gaussians ready to be traced. Those with opacity <= ALPHA_MIN, no area, or values that are not finite are left out.

    Attributes:
        parameters: the flat position, quaternion, log scale and opacity it stands for.
        record: (N, SURFEL_RECORD) numbers of each disk.
        child: (nodes, 8) int32, see `build_nodes`. node: (nodes x NODE,) boxes. depth: levels of nodes.
        index: (leaves x 8,) int32 Gaussian in each place of each leaf, -1 where none. leaf: (leaves x LEAF,) their numbers.
    """

    parameters: tuple[np.ndarray, ...]
    record: np.ndarray
    child: np.ndarray
    node: np.ndarray
    index: np.ndarray
    leaf: np.ndarray
    depth: int

    @classmethod
    def build(cls, position: torch.Tensor, quaternion: torch.Tensor, log_scale: torch.Tensor, opacity: torch.Tensor) -> SurfelTree:
        """A tree over raw parameters: (3, N) world, (4, N) w x y z of any length, (2, N) logs, (N,) logits; no gradients."""
        parameters = tuple(flat(p).copy() for p in (position, quaternion, log_scale, opacity))
        record, boxes, middle = _describe(parameters)
        order = np.flatnonzero(record[:, CUT] >= 0).astype(np.int32)
        child, ranges, depth = np.empty((0, 8), np.int32), np.empty((0, 2), np.int32), 0
        if len(order):
            child, ranges, depth = build_nodes(order, boxes, middle)
        place = ranges[:, :1] + np.arange(8, dtype=np.int32)
        index = np.where(place < ranges[:, 1:], order[np.minimum(place, max(len(order) - 1, 0))] if len(order) else -1, -1)
        tree = cls(parameters, record, child, aligned(len(child) * NODE), index.reshape(-1).astype(np.int32),
                   aligned(len(index) * LEAF), int(depth))  # fmt: skip
        tree._fill(boxes)
        return tree

    def refit(self, position: torch.Tensor, quaternion: torch.Tensor, log_scale: torch.Tensor, opacity: torch.Tensor) -> None:
        """Follow parameters that have moved: same topology, new numbers. Built anew where a Gaussian left out can now be seen."""
        parameters = tuple(flat(p).copy() for p in (position, quaternion, log_scale, opacity))
        record, boxes, _ = _describe(parameters)
        held = np.zeros(len(record), bool)
        held[self.index[self.index >= 0]] = True
        if len(record) != len(self.record) or (~held & (record[:, CUT] >= 0)).any():
            self.__dict__.update(SurfelTree.build(position, quaternion, log_scale, opacity).__dict__)
            return
        self.parameters, self.record = parameters, record
        self._fill(boxes)

    def matches(self, *parameters: torch.Tensor) -> bool:
        """Whether the tree stands for exactly these position, quaternion, log scale and opacity."""
        pairs = zip(self.parameters, parameters, strict=True)
        return all(np.array_equal(mine.view(np.int32), flat(theirs).view(np.int32)) for mine, theirs in pairs)  # NaN equals NaN

    def _fill(self, boxes: np.ndarray) -> None:
        fill_leaves(self.index, self.record, self.leaf)
        fill_nodes(self.child, self.index, boxes, self.node)


def _describe(parameters: tuple[np.ndarray, ...]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    n = len(parameters[3])
    record, boxes, middle = np.empty((n, SURFEL_RECORD), np.float32), np.empty(8 * n, np.float32), np.empty(8 * n, np.float32)
    describe_surfels(*parameters, n, record, boxes, middle)
    return record, boxes, middle
