# SPDX-License-Identifier: GPL-3.0-or-later
"""Bounding volume hierarchy, 8-wide, over 2D Gaussians, each bounded where its alpha falls below ALPHA_MIN.

A node holds the boxes of up to 8 children next to each other, a leaf up to 8 surfels, so that one vector operation tests all of them.
Splits follow the binned surface area heuristic; a leaf costs the same however full it is.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import torch

from ..constants import ALPHA_MIN, AXIS_U, AXIS_V, CUT, NORMAL, OPACITY, SCALE_RANGE, SCALE_U, SCALE_V, SURFEL_RECORD
from .bvh_build import build_nodes, grow
from .jit import kernel
from .simd import splat, store

LEAF = 14 * 8  # floats of a leaf: the columns of the record up to CUT, 8 surfels each
NODE = 6 * 8  # floats of a node: low x y z, high x y z, 8 children each
_PAD = np.float32(1e-6)  # boxes grow by this fraction of their position and 10 times this of their size, against rounding


@kernel
def describe_surfels(position, quaternion, log_scale, opacity, n, record, box, middle):
    """Write records (N, SURFEL_RECORD), boxes and centres (N x 8,) of all surfels.

    Where nothing can be hit, CUT is -1 and the box empty.
    """
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
def fill_leaves(index, record, leaf):
    """Copy the records of `index` (leaves x 8, -1 where empty) to leaves (leaves x LEAF), 8 surfels next to each other."""
    for i in range(len(index)):
        at = (i // 8) * LEAF + i % 8
        for j in range(LEAF // 8):
            leaf[at + j * 8] = record[index[i], j] if index[i] >= 0 else np.float32(0.0)
        if index[i] < 0:
            leaf[at + CUT * 8] = np.float32(-1.0)


@kernel
def fill_nodes(child, index, boxes, node):
    """Compute the boxes of all children, node (nodes x NODE), from the last node to the first."""
    box = np.empty(8, np.float32)
    for i in range(len(child) - 1, -1, -1):
        for lane in range(8):
            c = child[i, lane]
            store(box, 0, splat(np.float32(math.inf)))
            if c < 0:
                for j in range(~c * 8, ~c * 8 + 8):
                    if index[j] >= 0:
                        grow(box, 0, boxes, index[j])
            elif c != i:
                for axis in range(3):
                    for j in range(8):
                        box[axis] = min(box[axis], node[c * NODE + axis * 8 + j])
                        box[4 + axis] = min(box[4 + axis], -node[c * NODE + 24 + axis * 8 + j])
            for axis in range(3):
                node[i * NODE + axis * 8 + lane] = box[axis]
                node[i * NODE + 24 + axis * 8 + lane] = -box[4 + axis]


def aligned(floats: int) -> np.ndarray:
    """Return an uninitialised (floats,) float32 array that starts on a cache line: vectors across two lines cost two loads."""
    memory = np.empty(floats + 16, np.float32)
    first = -memory.ctypes.data % 64 // 4
    return memory[first : first + floats]


def flat(tensor: torch.Tensor) -> np.ndarray:
    """Return the values of a tensor of any shape (...,) as a contiguous 1-D float32 array, without its autograd history."""
    return tensor.detach().contiguous().view(-1).numpy()


@dataclass
class SurfelTree:
    """Bounding volume hierarchy over N Gaussians; those with opacity <= ALPHA_MIN, no area or non-finite values are left out.

    Attributes:
        parameters: flat position, quaternion, log scale and opacity that the tree was built from.
        record: (N, SURFEL_RECORD) record of each surfel.
        child: (nodes, 8) int32, see `build_nodes`.
        node: (nodes x NODE,) boxes of the children.
        index: (leaves x 8,) int32 Gaussian in each place of each leaf, -1 where empty.
        leaf: (leaves x LEAF,) records of the surfels in the leaves.
        depth: levels of nodes, 0 for an empty tree.
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
        """Build a tree over raw parameters; no gradients.

        Args:
            position: (3, N) centres, world.
            quaternion: (4, N) w x y z of any length.
            log_scale: (2, N) logarithms of the two scales.
            opacity: (N,) logits.
        """
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
        """Update the tree for changed parameters with the same topology; rebuild it where a Gaussian left out has become visible.

        Args:
            position: (3, N) centres, world.
            quaternion: (4, N) w x y z of any length.
            log_scale: (2, N) logarithms of the two scales.
            opacity: (N,) logits.
        """
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
        """Return True where position (3, N), quaternion (4, N), log scale (2, N) and opacity (N,) are bit for bit those of the tree."""
        pairs = zip(self.parameters, parameters, strict=True)
        return all(np.array_equal(mine.view(np.int32), flat(theirs).view(np.int32)) for mine, theirs in pairs)  # NaN equals NaN

    def _fill(self, boxes: np.ndarray) -> None:
        """Recompute leaves and nodes from the records and the boxes (8 N,) of the surfels."""
        fill_leaves(self.index, self.record, self.leaf)
        fill_nodes(self.child, self.index, boxes, self.node)


def _describe(parameters: tuple[np.ndarray, ...]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return records (N, SURFEL_RECORD), boxes (8 N,) and centres (8 N,) of flat parameters."""
    n = len(parameters[3])
    record, boxes, middle = np.empty((n, SURFEL_RECORD), np.float32), np.empty(8 * n, np.float32), np.empty(8 * n, np.float32)
    describe_surfels(*parameters, n, record, boxes, middle)
    return record, boxes, middle
