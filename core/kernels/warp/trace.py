# SPDX-License-Identifier: GPL-3.0-or-later
"""The ray tracer of 2D Gaussians on the device; its face is that of the CPU's, core/kernels/trace.py."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import torch
import warp as wp

from ..constants import SURFEL_GRADIENTS, SURFEL_RECORD
from . import adjoint
from . import surfels as surfels
from .runtime import launch, on_stream

SUMS = 8  # outputs beside the extras


@dataclass
class DeviceTree:
    """N Gaussians ready to be traced. Those that no ray can meet stay in the tree, where they are not hit.

    Attributes:
        record: (N, SURFEL_RECORD) numbers of each disk, see core/kernels/cpu/bvh.py.
    """

    record: torch.Tensor
    _boxes: tuple[torch.Tensor, torch.Tensor]
    _tree: wp.Bvh
    _stands_for: tuple[Any, ...]

    @classmethod
    def build(cls, position: torch.Tensor, quaternion: torch.Tensor, log_scale: torch.Tensor, opacity: torch.Tensor) -> DeviceTree:
        """A tree over raw parameters; see `DiskTree.build`."""
        n, device = len(opacity), opacity.device
        record, boxes = torch.empty(n, SURFEL_RECORD, device=device), (torch.empty(n, 3, device=device), torch.empty(n, 3, device=device))
        _describe(position, quaternion, log_scale, opacity, record, boxes)
        with on_stream(device):
            arrays = [wp.from_torch(box, wp.vec3) for box in boxes]
            # The best tree is built by the host, which waits for the boxes; this one is built where they are.
            tree = wp.Bvh(*arrays, constructor="lbvh" if device.type == "cuda" else "sah") if n else None
        return cls(record, boxes, tree, _copies(position, quaternion, log_scale, opacity))

    @property
    def id(self) -> wp.uint64:
        """What kernels know it by."""
        return wp.uint64(0) if self._tree is None else self._tree.id

    def refit(self, position: torch.Tensor, quaternion: torch.Tensor, log_scale: torch.Tensor, opacity: torch.Tensor) -> None:
        """Follow parameters that have moved; built anew where there are more of them, or fewer."""
        if len(opacity) != len(self.record) or self._tree is None:
            self.__dict__.update(DeviceTree.build(position, quaternion, log_scale, opacity).__dict__)
            return
        _describe(position, quaternion, log_scale, opacity, self.record, self._boxes)
        with on_stream(opacity.device):
            self._tree.refit()
        self._stands_for = _copies(position, quaternion, log_scale, opacity)

    def matches(self, *parameters: torch.Tensor) -> bool:
        """Whether the tree stands for exactly these. The host waits where they are other tensors than it was built from."""
        pairs = list(zip(parameters, self._stands_for, strict=True))
        return all(_identity(its) == where for its, (_, where, _) in pairs) or all(_same(its, copy) for its, (copy, _, _) in pairs)


def _identity(tensor: torch.Tensor) -> tuple[int, int, torch.Size]:
    return tensor.data_ptr(), tensor._version, tensor.shape


def _same(a: torch.Tensor, b: torch.Tensor) -> bool:
    """Bit by bit: NaN equals NaN."""
    return a.shape == b.shape and torch.equal(a.detach().contiguous().view(torch.int32), b.view(torch.int32))


def _copies(*parameters: torch.Tensor) -> tuple[Any, ...]:
    """What a tree was built from: the values, where they lie, and the tensors themselves, so that nothing else comes to lie there."""
    return tuple((p.detach().clone(memory_format=torch.contiguous_format), _identity(p), p.detach()) for p in parameters)


def _describe(position, quaternion, log_scale, opacity, record, boxes) -> None:
    if len(opacity):
        parameters = [p.detach().contiguous() for p in (position, quaternion, log_scale, opacity)]
        launch(surfels.describe, len(opacity), *parameters, len(opacity), record, *boxes)


@dataclass(frozen=True)
class DeviceLists:
    """`HitLists` on the device: tensors. of: (H,) int32 whose hit it is. longest: hits of a ray at most."""

    start: torch.Tensor
    index: torch.Tensor
    weight: torch.Tensor
    distance: torch.Tensor
    left: torch.Tensor
    of: torch.Tensor
    longest: int

    @property
    def rays(self) -> int:
        """R."""
        return len(self.start) - 1

    def chosen(self, rays: torch.Tensor) -> DeviceLists:
        """The lists of some of the rays, ascending."""
        length = self.start.diff()
        kept = torch.zeros_like(length, dtype=torch.bool)
        kept[rays] = True
        hits, length = kept[self.of.long()], length[rays]
        start = torch.nn.functional.pad(length.cumsum(0), (1, 0))
        of = torch.repeat_interleave(torch.arange(len(rays), device=length.device), length).int()
        return DeviceLists(start, self.index[hits], self.weight[hits], self.distance[hits], self.left[rays], of, self.longest)

    def joined(self, parts: Sequence[Any]) -> DeviceLists:
        """Several sets of rays, of which this is the first, one after the other."""
        start, of, hits, rays = [self.start[:1]], [], 0, 0
        for part in parts:
            start.append(part.start[1:] + hits)
            of.append(part.of + rays)
            hits, rays = hits + len(part.index), rays + part.rays
        rest = [torch.cat([getattr(part, name) for part in parts]) for name in ("index", "weight", "distance", "left")]
        return DeviceLists(torch.cat(start), *rest, torch.cat(of), max(part.longest for part in parts))


def _see(tree: DeviceTree, origin, direction, sh: torch.Tensor, coefficients: int, extra: torch.Tensor):
    """Sums (R, 8 + E), hits of each ray, transmittance behind them; rows: sh (N, 3, K), extra (N, E)."""
    rays, extras, device = len(origin), extra.shape[1], origin.device
    out, left = torch.zeros(rays, SUMS + extras, device=device), torch.ones(rays, device=device)
    count = torch.zeros(rays, dtype=torch.int64, device=device)
    if rays and len(tree.record):
        rows = (sh, coefficients, extra)
        launch(surfels.composite(extras), rays, tree.id, tree.record, origin, direction, *rows, out, count, left)
    return out, count, left


def _gathered(tree: DeviceTree, origin, direction, count: torch.Tensor, left: torch.Tensor) -> DeviceLists:
    """The hits that were counted. The host waits for their number."""
    device = origin.device
    start = torch.cat([torch.zeros(1, dtype=torch.int64, device=device), torch.cumsum(count, 0)])
    total, longest = (int(x) for x in torch.stack([start[-1], count.max() if len(count) else start[-1]]).cpu().tolist())
    index, of = torch.empty(2, total, dtype=torch.int32, device=device)
    weight, distance = torch.empty(2, total, device=device)
    if total:
        launch(surfels.gather, len(count), tree.id, tree.record, origin, direction, start, index, weight, distance, of)
    return DeviceLists(start, index, weight, distance, left, of, longest)


def hit_lists(tree: DeviceTree, origin: torch.Tensor, direction: torch.Tensor) -> DeviceLists:
    """Hits of rays (R, 3), see core/kernels/trace.py."""
    origin, direction = origin.detach().contiguous(), direction.detach().contiguous()
    nothing = torch.empty(len(tree.record), 0, device=origin.device)
    _, count, left = _see(tree, origin, direction, nothing, 0, nothing)
    return _gathered(tree, origin, direction, count, left)


def transmittance(tree: DeviceTree, origin: torch.Tensor, direction: torch.Tensor) -> torch.Tensor:
    """(R,) share of light that passes, see core/kernels/trace.py."""
    through = torch.ones(len(origin), device=origin.device)
    if len(origin) and len(tree.record):
        rays = (origin.detach().contiguous(), direction.detach().contiguous())
        launch(surfels.pass_through, len(origin), tree.id, tree.record, *rays, through)
    return through


def rows_of(sh: torch.Tensor | None, extra: torch.Tensor, coefficients: int) -> tuple[torch.Tensor, torch.Tensor]:
    """Parameters (K, 3, N), (E, N) as rows of Gaussians, (N, 3, K) and (N, E)."""
    coloured = extra.new_empty(extra.shape[1], 3, 0) if sh is None else sh.detach()[:coefficients].permute(2, 1, 0).contiguous()
    return coloured, extra.detach().T.contiguous()


def by_gaussian(index: torch.Tensor, n: int) -> tuple[torch.Tensor, torch.Tensor]:
    """Hits (H,) sorted by Gaussian, in their order, (H,), and where each one's begin, (N + 1,) int32."""
    key, order = torch.sort(index, stable=True)
    return order, torch.searchsorted(key, torch.arange(n + 1, dtype=torch.int32, device=index.device), out_int32=True)


class Trace(torch.autograd.Function):
    """The face is that of the CPU's. Going back, the host waits once for the number of hits; frozen geometry never does."""

    @staticmethod
    def forward(ctx, position, quaternion, log_scale, opacity, sh, extra, origin, direction, tree, coefficients):
        rays, rows = (origin.detach().contiguous(), direction.detach().contiguous()), rows_of(sh, extra, coefficients)
        out, count, left = _see(tree, *rays, rows[0], coefficients, rows[1])
        ctx.tree, ctx.rays, ctx.rows, ctx.coefficients, ctx.hits = tree, rays, rows, coefficients, (count, left)
        ctx.record, ctx.quaternion = tree.record.clone() if any(ctx.needs_input_grad[:4]) else tree.record, quaternion.detach().contiguous()
        ctx.shapes = [None if p is None else p.shape for p in (position, quaternion, log_scale, opacity, sh, extra, origin, direction)]
        ctx.save_for_backward(out)
        return out

    @staticmethod
    def backward(ctx, gradient):
        gradient, device, n = gradient.contiguous(), gradient.device, len(ctx.record)
        gradients = [None if shape is None else torch.zeros(shape, device=device) for shape in ctx.shapes]
        lists = _gathered(ctx.tree, *ctx.rays, *ctx.hits)
        (sh, extra), k, extras = ctx.rows, ctx.coefficients, ctx.shapes[5][0]
        if len(lists.index):
            order, first = by_gaussian(lists.index, n)
            if any(ctx.needs_input_grad[:4]) or any(ctx.needs_input_grad[6:8]):
                of_hit = torch.empty(len(lists.index), SURFEL_GRADIENTS, device=device)
                hits = (lists.start, lists.index, lists.weight, lists.distance, lists.left)
                images = (ctx.saved_tensors[0].detach(), gradient)
                rows = (sh, k, extra, extras)
                launch(adjoint.trace_backward, lists.rays, *ctx.rays, *hits, ctx.record, *rows, *images, of_hit, *gradients[6:8])
                launch(adjoint.surfel_backward, n, order, first, of_hit, ctx.record, ctx.quaternion, n, *gradients[:4])
            g_sh = torch.empty(0, device=device) if gradients[4] is None else gradients[4]
            rows = (ctx.rays[1], sh, k, extras)
            launch(adjoint.rows_backward, (n, 3 + extras), order, first, lists.of, lists.weight, *rows, gradient, n, g_sh, gradients[5])
        wanted = zip(ctx.needs_input_grad, gradients, strict=False)
        return *(g if needed else None for needed, g in wanted), None, None


class Seen:
    """See core/kernels/trace.py; nothing here makes the host wait."""

    def __init__(self, tree: DeviceTree, sh: torch.Tensor, extra: torch.Tensor) -> None:
        self._tree, self._coefficients = tree, len(sh)
        self._rows = rows_of(sh, extra, len(sh))

    def along(self, origin: torch.Tensor, direction: torch.Tensor) -> torch.Tensor:
        """(R, 8 + E) sums."""
        rays = (origin.detach().contiguous(), direction.detach().contiguous())
        return _see(self._tree, *rays, self._rows[0], self._coefficients, self._rows[1])[0]


class Blend(torch.autograd.Function):
    """Weighted sums of values over known hits."""

    @staticmethod
    def forward(ctx, values, lists, ray):
        out = torch.zeros(len(ray), len(values), device=values.device)
        if len(lists.index):
            launch(surfels.blend, out.shape, ray, lists.start, lists.index, lists.weight, values.detach().contiguous(), out)
        ctx.lists, ctx.ray, ctx.shape = lists, ray, values.shape
        return out

    @staticmethod
    def backward(ctx, gradient):
        lists, ray, (channels, n) = ctx.lists, ctx.ray, ctx.shape
        out = torch.zeros(channels, n, device=gradient.device)
        if len(lists.index) and len(ray):
            padded = torch.empty(len(ray), lists.longest, dtype=torch.int32, device=gradient.device)
            launch(adjoint.pad_hits, padded.shape, ray, lists.start, lists.index, lists.longest, n, padded)
            order, first = by_gaussian(padded.view(-1), n)
            arrays = (order, first, ray, lists.start, lists.longest, lists.weight, gradient.contiguous(), out)
            launch(adjoint.blend_backward, (channels, n), *arrays)
        return out, None, None
