# SPDX-License-Identifier: GPL-3.0-or-later
"""Bounding volume hierarchy of 2D Gaussians on the GPU."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import torch
import warp as wp

from ..constants import SURFEL_RECORD
from . import surfels
from .nodes import Nodes
from .runtime import launch, on_stream


@dataclass
class DeviceTree:
    """Warp's bounding volume hierarchy over N Gaussians; those that no ray can hit stay in it and are never hit.

    Attributes:
        record: (N, SURFEL_RECORD) record of each surfel, see core/kernels/cpu/bvh.py.
    """

    record: torch.Tensor
    _boxes: tuple[torch.Tensor, torch.Tensor]
    _tree: wp.Bvh
    _nodes: Nodes | None
    _source: tuple[Any, ...]

    @classmethod
    def build(
        cls, position: torch.Tensor, quaternion: torch.Tensor, log_scale: torch.Tensor, opacity: torch.Tensor, lasting: bool = True
    ) -> DeviceTree:
        """Build a tree over raw parameters, see `SurfelTree.build`.

        Args:
            position: (3, N) centres, world.
            quaternion: (4, N) w x y z of any length.
            log_scale: (2, N) logarithms of the two scales.
            opacity: (N,) logits.
            lasting: build the best tree ("sah"), on the host, which waits for the boxes; else another ("lbvh"), on the device.
        """
        n, device = len(opacity), opacity.device
        record, boxes = torch.empty(n, SURFEL_RECORD, device=device), (torch.empty(n, 3, device=device), torch.empty(n, 3, device=device))
        _describe(position, quaternion, log_scale, opacity, record, boxes)
        with on_stream(device):
            arrays = [wp.from_torch(box, wp.vec3) for box in boxes]
            tree = wp.Bvh(*arrays, constructor="sah" if lasting or device.type != "cuda" else "lbvh") if n else None
            nodes = Nodes(tree, n, device) if n else None
        return cls(record, boxes, tree, nodes, _snapshot(position, quaternion, log_scale, opacity))

    @property
    def id(self) -> wp.uint64:
        """Identifier of the tree for kernels; 0 for an empty one."""
        return wp.uint64(0) if self._tree is None else self._tree.id

    @property
    def layout(self) -> tuple[torch.Tensor, torch.Tensor]:
        """Nodes and items of the tree, see `Nodes`; it must not be empty."""
        assert self._nodes is not None
        return self._nodes.nodes, self._nodes.items

    def refit(self, position: torch.Tensor, quaternion: torch.Tensor, log_scale: torch.Tensor, opacity: torch.Tensor) -> None:
        """Update the tree for changed parameters; rebuild it where their number changed.

        Args:
            position: (3, N) centres, world.
            quaternion: (4, N) w x y z of any length.
            log_scale: (2, N) logarithms of the two scales.
            opacity: (N,) logits.
        """
        if len(opacity) != len(self.record) or self._tree is None or self._nodes is None:
            self.__dict__.update(DeviceTree.build(position, quaternion, log_scale, opacity, lasting=False).__dict__)
            return
        _describe(position, quaternion, log_scale, opacity, self.record, self._boxes)
        with on_stream(opacity.device):
            self._tree.refit()
            self._nodes.update(self._tree)
        self._source = _snapshot(position, quaternion, log_scale, opacity)

    def matches(self, *parameters: torch.Tensor) -> bool:
        """Return True where the parameters are bit for bit those of the tree.

        Args:
            *parameters: position (3, N), quaternion (4, N), log scale (2, N), opacity (N,). The host waits unless they are the very tensors
                that the tree was built from, unchanged.
        """
        pairs = list(zip(parameters, self._source, strict=True))
        return all(_identity(its) == where for its, (_, where, _) in pairs) or all(_bit_equal(its, copy) for its, (copy, _, _) in pairs)


def _identity(tensor: torch.Tensor) -> tuple[int, int, torch.Size]:
    """Return what identifies a tensor's contents without reading them: address, version and shape."""
    return tensor.data_ptr(), tensor._version, tensor.shape


def _bit_equal(a: torch.Tensor, b: torch.Tensor) -> bool:
    """Compare two tensors bit by bit: NaN equals NaN."""
    return a.shape == b.shape and torch.equal(a.detach().contiguous().view(torch.int32), b.view(torch.int32))


def _snapshot(*parameters: torch.Tensor) -> tuple[Any, ...]:
    """Return what a tree was built from: the values, their identity, and the tensors themselves.

    Holding the tensors keeps their memory from being reused, so that an equal address means an equal tensor.
    """
    return tuple((p.detach().clone(memory_format=torch.contiguous_format), _identity(p), p.detach()) for p in parameters)


def _describe(position, quaternion, log_scale, opacity, record, boxes) -> None:
    """Write records and boxes of the surfels."""
    if len(opacity):
        parameters = [p.detach().contiguous() for p in (position, quaternion, log_scale, opacity)]
        launch(surfels.describe, len(opacity), *parameters, len(opacity), record, *boxes)
