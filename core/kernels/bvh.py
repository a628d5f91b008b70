# SPDX-License-Identifier: GPL-3.0-or-later
"""An 8-wide bounding volume hierarchy over 2D Gaussians, each bounded where its alpha falls below ALPHA_MIN.

A node holds the boxes of up to 8 children side by side, a leaf up to 8 disks, so that one vector operation tests them all.
Splits follow the surface area heuristic in bins, a leaf costing the same however full it is.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import torch

from .jit import kernel
from .projection import ALPHA_MIN

# Floats of a disk's record: centre (3), normal (3), t_u / s_u (3), t_v / s_v (3), opacity, largest rho, and the two scales.
NORMAL, AXIS_U, AXIS_V, OPACITY, CUT, SCALE_U, SCALE_V, DISK = 3, 6, 9, 12, 13, 14, 15, 16
LEAF = 14 * 8  # floats of a leaf: the record up to CUT, 8 disks to each
NODE = 6 * 8  # floats of a node: low x y z, high x y z, 8 children to each
_BINS = 16
_SCALES = (1e-15, 1e15)  # lengths outside are none, or not a number (math.isfinite may be reordered away here)
_PAD = np.float32(1e-6)  # boxes grow by this share of their position, ten times that of their size: rounding must not lose a hit


@kernel
def describe_disks(position, quaternion, log_scale, opacity, n, record, low, high):
    """Records (N, DISK) and boxes (N, 3) of all disks; CUT is -1, and the box empty, where there is nothing to hit."""
    for i in range(n):
        w, x, y, z = quaternion[i], quaternion[n + i], quaternion[2 * n + i], quaternion[3 * n + i]
        inv = np.float32(1.0) / np.float32(math.sqrt(max(w * w + x * x + y * y + z * z, np.float32(1e-20))))
        w, x, y, z = w * inv, x * inv, y * inv, z * inv
        u = (1 - 2 * (y * y + z * z), 2 * (x * y + w * z), 2 * (x * z - w * y))
        v = (2 * (x * y - w * z), 1 - 2 * (x * x + z * z), 2 * (y * z + w * x))
        normal = (2 * (x * z + w * y), 2 * (y * z - w * x), 1 - 2 * (x * x + y * y))
        su, sv = np.float32(math.exp(log_scale[i])), np.float32(math.exp(log_scale[n + i]))
        alpha = np.float32(1.0) / (np.float32(1.0) + np.float32(math.exp(-opacity[i])))
        valid = alpha > ALPHA_MIN and _SCALES[0] < su < _SCALES[1] and _SCALES[0] < sv < _SCALES[1]
        for axis in range(3):
            valid = valid and abs(position[axis * n + i]) < _SCALES[1] and abs(normal[axis]) < 2
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
            low[i, axis] = c - reach if valid else np.float32(math.inf)
            high[i, axis] = c + reach if valid else np.float32(-math.inf)


@kernel
def _area(box):
    x, y, z = box[3] - box[0], box[4] - box[1], box[5] - box[2]
    return x * y + y * z + z * x


@kernel
def _include(box, low, high):
    for axis in range(3):
        box[axis] = min(box[axis], low[axis])
        box[3 + axis] = max(box[3 + axis], high[axis])


@kernel
def _clear(box):
    box[:3] = np.float32(math.inf)
    box[3:] = np.float32(-math.inf)


@kernel
def _bound(order, begin, end, low, high, box):
    _clear(box)
    for i in range(begin, end):
        _include(box, low[order[i]], high[order[i]])


@kernel
def _bin(low, high, g, axis, start, step):
    return min(max(int((low[g, axis] + high[g, axis] - start) * step), 0), _BINS - 1)


@kernel
def _split(order, begin, end, low, high, bins, fill, cost, box):
    """Part order[begin:end] in two along the widest axis of the centres; returns where the second half starts."""
    least, most = np.full(3, math.inf, np.float32), np.full(3, -math.inf, np.float32)
    for i in range(begin, end):
        g = order[i]
        for axis in range(3):
            c = low[g, axis] + high[g, axis]
            least[axis], most[axis] = min(least[axis], c), max(most[axis], c)
    extent = most - least
    axis = np.argmax(extent)
    if not extent[axis] > 0:
        return (begin + end) // 2
    start, step = least[axis], np.float32(_BINS * 0.9999) / extent[axis]
    fill[:] = 0
    for b in range(_BINS):
        _clear(bins[b])
    for i in range(begin, end):
        g = order[i]
        b = _bin(low, high, g, axis, start, step)
        fill[b] += 1
        _include(bins[b], low[g], high[g])
    _clear(box)
    count = 0
    for b in range(_BINS - 1):
        _include(box, bins[b, :3], bins[b, 3:])
        count += fill[b]
        cost[b] = _area(box) * ((count + 7) // 8)
    _clear(box)
    count, best, least_cost = 0, 0, np.float32(math.inf)
    for b in range(_BINS - 1, 0, -1):
        _include(box, bins[b, :3], bins[b, 3:])
        count += fill[b]
        if 0 < count < end - begin:
            total = cost[b - 1] + _area(box) * ((count + 7) // 8)
            if total < least_cost:
                best, least_cost = b, total
    left, right = begin, end - 1
    while left <= right:
        g = order[left]
        if _bin(low, high, g, axis, start, step) < best:
            left += 1
        else:
            order[left], order[right] = order[right], g
            right -= 1
    return left if begin < left < end else (begin + end) // 2


@kernel
def build_nodes(order, low, high):
    """Sort `order` (M,) into leaves. Returns children (nodes, 8), leaf ranges in `order` (leaves, 2) and the tree's depth.

    A child is a later node's number, ~leaf, or its own node's number where there is none.
    """
    m = len(order)
    child = np.empty((m + 1, 8), np.int32)
    leaves = np.empty((m + 1, 2), np.int32)
    begins, ends, levels = np.empty(m + 1, np.int32), np.empty(m + 1, np.int32), np.empty(m + 1, np.int32)
    bins, fill, cost = np.empty((_BINS, 6), np.float32), np.empty(_BINS, np.int32), np.empty(_BINS, np.float32)
    box, area = np.empty(6, np.float32), np.empty(8, np.float32)
    part = np.empty((8, 2), np.int32)
    begins[0], ends[0], levels[0] = 0, m, 1
    nodes, leaf_count, node = 1, 0, 0
    while node < nodes:
        part[0, 0], part[0, 1], area[0], parts = begins[node], ends[node], np.float32(math.inf), 1
        while parts < 8:
            widest, largest = -1, np.float32(-1.0)
            for p in range(parts):
                if part[p, 1] - part[p, 0] > 8 and area[p] > largest:
                    widest, largest = p, area[p]
            if widest < 0:
                break
            begin, end = part[widest, 0], part[widest, 1]
            middle = _split(order, begin, end, low, high, bins, fill, cost, box)
            part[widest, 1], part[parts, 0], part[parts, 1] = middle, middle, end
            for p in (widest, parts):
                _bound(order, part[p, 0], part[p, 1], low, high, box)
                area[p] = _area(box)
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
    """Copy the records of `index` (leaves x 8, -1 where empty) into leaves, 8 disks side by side."""
    for i in range(len(index)):
        at = (i // 8) * LEAF + i % 8
        for j in range(LEAF // 8):
            leaf[at + j * 8] = record[index[i], j] if index[i] >= 0 else np.float32(0.0)
        if index[i] < 0:
            leaf[at + CUT * 8] = np.float32(-1.0)


@kernel
def fill_nodes(child, index, low, high, node):
    """Boxes of all children, from the last node to the first."""
    box = np.empty(6, np.float32)
    for i in range(len(child) - 1, -1, -1):
        for lane in range(8):
            c = child[i, lane]
            _clear(box)
            if c < 0:
                for j in range(~c * 8, ~c * 8 + 8):
                    if index[j] >= 0:
                        _include(box, low[index[j]], high[index[j]])
            elif c != i:
                for axis in range(3):
                    for j in range(8):
                        box[axis] = min(box[axis], node[c * NODE + axis * 8 + j])
                        box[3 + axis] = max(box[3 + axis], node[c * NODE + 24 + axis * 8 + j])
            for j in range(6):
                node[i * NODE + j * 8 + lane] = box[j]


def flat(tensor: torch.Tensor) -> np.ndarray:
    """A tensor's values as a contiguous 1-D float32 array, without its history."""
    return tensor.detach().contiguous().view(-1).numpy()


@dataclass
class DiskTree:
    """N Gaussians ready to be traced. Those with opacity <= ALPHA_MIN, no area, or values that are not finite are left out.

    Attributes:
        parameters: the flat position, quaternion, log scale and opacity it stands for.
        record: (N, DISK) numbers of each disk.
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
    def build(cls, position: torch.Tensor, quaternion: torch.Tensor, log_scale: torch.Tensor, opacity: torch.Tensor) -> DiskTree:
        """A tree over raw parameters: (3, N) world, (4, N) w x y z of any length, (2, N) logs, (N,) logits; no gradients."""
        parameters = tuple(flat(p).copy() for p in (position, quaternion, log_scale, opacity))
        record, low, high = _describe(parameters)
        order = np.flatnonzero(record[:, CUT] >= 0).astype(np.int32)
        child, ranges, depth = np.empty((0, 8), np.int32), np.empty((0, 2), np.int32), 0
        if len(order):
            child, ranges, depth = build_nodes(order, low, high)
        place = ranges[:, :1] + np.arange(8, dtype=np.int32)
        index = np.where(place < ranges[:, 1:], order[np.minimum(place, max(len(order) - 1, 0))] if len(order) else -1, -1)
        tree = cls(parameters, record, child, np.empty(len(child) * NODE, np.float32), index.reshape(-1).astype(np.int32),
                   np.empty(len(index) * LEAF, np.float32), int(depth))  # fmt: skip
        tree._fill(low, high)
        return tree

    def refit(self, position: torch.Tensor, quaternion: torch.Tensor, log_scale: torch.Tensor, opacity: torch.Tensor) -> None:
        """Follow parameters that have moved: same topology, new numbers. Built anew where a Gaussian left out can now be seen."""
        parameters = tuple(flat(p).copy() for p in (position, quaternion, log_scale, opacity))
        record, low, high = _describe(parameters)
        held = np.zeros(len(record), bool)
        held[self.index[self.index >= 0]] = True
        if len(record) != len(self.record) or (~held & (record[:, CUT] >= 0)).any():
            self.__dict__.update(DiskTree.build(position, quaternion, log_scale, opacity).__dict__)
            return
        self.parameters, self.record = parameters, record
        self._fill(low, high)

    def matches(self, *parameters: torch.Tensor) -> bool:
        """Whether the tree stands for exactly these position, quaternion, log scale and opacity."""
        pairs = zip(self.parameters, parameters, strict=True)
        return all(np.array_equal(mine.view(np.int32), flat(theirs).view(np.int32)) for mine, theirs in pairs)  # NaN equals NaN

    def _fill(self, low: np.ndarray, high: np.ndarray) -> None:
        fill_leaves(self.index, self.record, self.leaf)
        fill_nodes(self.child, self.index, low, high, self.node)


def _describe(parameters: tuple[np.ndarray, ...]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    n = len(parameters[3])
    record, low, high = np.empty((n, DISK), np.float32), np.empty((n, 3), np.float32), np.empty((n, 3), np.float32)
    describe_disks(*parameters, n, record, low, high)
    return record, low, high
