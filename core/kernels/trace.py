# SPDX-License-Identifier: GPL-3.0-or-later
"""The one face of the ray tracer of 2D Gaussians (2DGRT): rays in, what they see out, differentiable."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np
import torch

from ..machine import backend
from ..machine.thread_pool import balanced_ranges, even_ranges, run_ranges, thread_count
from .constants import SURFEL_GRADIENTS
from .cpu.adjoint import surfel_backward_range, trace_backward_range
from .cpu.bvh import SurfelTree, flat
from .cpu.compositing import (
    SH_ROW,
    SUMS,
    blend_backward_range,
    blend_range,
    composite_backward_range,
    composite_range,
    pack_range,
    unpack_range,
)
from .cpu.trace import gather_range, transmittance_range

if TYPE_CHECKING:
    from .warp.trace import DeviceLists, DeviceTree

Tree: TypeAlias = "SurfelTree | DeviceTree"
Lists: TypeAlias = "HitLists | DeviceLists"

COLOUR, NORMAL, EXTRA = slice(0, 3), slice(3, 6), 6  # columns of what `trace` returns; distance and opacity follow the extras


@dataclass(frozen=True)
class HitLists:
    """What R rays meet, in the order they meet it.

    Attributes:
        start: (R + 1,) int64, ray r's hits are start[r] : start[r + 1].
        index: (H,) int32 Gaussian. weight: (H,) float32 its share of the ray; they sum to the ray's opacity, to 1 where the ray
            counts as opaque.
        distance: (H,) float32 along the ray.
        left: (R,) float32 transmittance behind the last hit, before opaque rays are counted as such.
    """

    start: np.ndarray
    index: np.ndarray
    weight: np.ndarray
    distance: np.ndarray
    left: np.ndarray

    @property
    def rays(self) -> int:
        """R."""
        return len(self.start) - 1


def _device() -> Any:
    """What does the work where warp does: an option, not installed everywhere."""
    from .warp import trace as tracing

    return tracing


def build_tree(position: torch.Tensor, quaternion: torch.Tensor, log_scale: torch.Tensor, opacity: torch.Tensor) -> Tree:
    """A tree over raw parameters: (3, N) world, (4, N) w x y z of any length, (2, N) logs, (N,) logits; no gradients."""
    kind = _device().DeviceTree if backend.by_warp(opacity) else SurfelTree
    return kind.build(position, quaternion, log_scale, opacity)


def _check(origin: torch.Tensor, direction: torch.Tensor) -> None:
    if origin.shape != direction.shape or origin.ndim != 2 or origin.shape[1] != 3:
        raise ValueError(f"rays need origins and directions of one shape (R, 3), got {tuple(origin.shape)} and {tuple(direction.shape)}")


def hit_lists(tree: Tree, origin: torch.Tensor, direction: torch.Tensor) -> Lists:
    """Hits of rays (R, 3) with unit directions, in exact order, until the transmittance falls below TRANSMITTANCE_MIN."""
    _check(origin, direction)
    return _numba_lists(tree, origin, direction) if isinstance(tree, SurfelTree) else _device().hit_lists(tree, origin, direction)


def _numba_lists(tree: SurfelTree, origin: torch.Tensor, direction: torch.Tensor) -> HitLists:
    o, d = flat(origin), flat(direction)
    rays = len(origin)
    count, left = np.zeros(rays, np.int64), np.ones(rays, np.float32)
    parts = [(np.empty(0, np.int32), np.empty(0, np.float32), np.empty(0, np.float32))]
    if tree.depth and rays:
        arrays = (o, d, tree.node, tree.child, tree.leaf, tree.index, tree.depth, count, left)
        parts = run_ranges(gather_range, even_ranges(rays, 4 * thread_count()), *arrays)
    start = np.concatenate([np.zeros(1, np.int64), np.cumsum(count)])
    index, weight, distance = (p[0] if len(parts) == 1 else np.concatenate(p) for p in zip(*parts, strict=True))
    return HitLists(start, index, weight, distance, left)


def transmittance(tree: Tree, origin: torch.Tensor, direction: torch.Tensor) -> torch.Tensor:
    """(R,) share of light that passes along rays (R, 3), 0 below TRANSMITTANCE_MIN; no gradients."""
    _check(origin, direction)
    if not isinstance(tree, SurfelTree):
        return _device().transmittance(tree, origin, direction)
    o, d, through = flat(origin), flat(direction), torch.ones(len(origin))
    if tree.depth and len(origin):
        arrays = (o, d, tree.node, tree.child, tree.leaf, tree.depth, through.numpy())
        run_ranges(transmittance_range, even_ranges(len(origin), 4 * thread_count()), *arrays)
    return through


def _whole(channels: int) -> int:
    """Floats of a row that holds so many channels in whole vectors."""
    return -(-channels // 8) * 8


def _pack(sh: torch.Tensor | None, extra: torch.Tensor, coefficients: int) -> np.ndarray:
    n = extra.shape[1]
    rows = np.empty((n, (SH_ROW if coefficients else 0) + _whole(len(extra))), np.float32)
    values = np.empty(0, np.float32) if sh is None else flat(sh)
    run_ranges(pack_range, even_ranges(n, thread_count()), values, flat(extra), coefficients, n, rows)
    return rows


def _composite(
    tree: SurfelTree, lists: HitLists, direction: torch.Tensor, rows: np.ndarray, coefficients: int, extras: int
) -> tuple[torch.Tensor, np.ndarray, list[tuple[int, int]]]:
    """Sums (R, 8 + E) over the hits, which channels of colour each hit lit, and the ranges of rays that were worked on at a time."""
    out = torch.empty(lists.rays, SUMS + extras)
    lit = np.empty(len(lists.index), np.uint8)
    hits = (lists.start, lists.index, lists.weight, lists.distance, lists.left)
    ranges = balanced_ranges(np.diff(lists.start) + 1, thread_count())
    run_ranges(composite_range, ranges, flat(direction), *hits, tree.record, rows, coefficients, extras, out.numpy(), lit)
    return out, lit, ranges


class _Trace(torch.autograd.Function):
    """CPU backend."""

    @staticmethod
    def forward(ctx, position, quaternion, log_scale, opacity, sh, extra, origin, direction, tree, coefficients):
        lists = _numba_lists(tree, origin, direction)
        rows = _pack(sh, extra, coefficients)
        out, lit, ranges = _composite(tree, lists, direction, rows, coefficients, len(extra))
        ctx.lists, ctx.lit, ctx.ranges, ctx.rays = lists, lit, ranges, (flat(origin), flat(direction))
        ctx.record, ctx.quaternion, ctx.rows, ctx.coefficients = tree.record, tree.parameters[1], rows, coefficients
        ctx.shapes = [None if p is None else p.shape for p in (position, quaternion, log_scale, opacity, sh, extra, origin, direction)]
        ctx.save_for_backward(out)
        return out

    @staticmethod
    def backward(ctx, gradient):
        geometry = any(ctx.needs_input_grad[:4]) or any(ctx.needs_input_grad[6:8])
        gradients = [None if shape is None else torch.zeros(shape) for shape in ctx.shapes]
        outputs = [np.empty(0, np.float32) if g is None else g.view(-1).numpy() for g in gradients]
        gradient = gradient.contiguous().numpy()
        (n, width), extras = ctx.rows.shape, ctx.shapes[5][0]
        slots = np.zeros((len(ctx.ranges), n, width + (SURFEL_GRADIENTS if geometry else 0)), np.float32)
        if geometry:
            _geometry_backward(ctx, gradient, slots, gradients, outputs)
        else:
            arrays = (ctx.rays[1], ctx.lists.start, ctx.lists.index, ctx.lists.weight, ctx.lit, ctx.coefficients, extras)
            run_ranges(composite_backward_range, ctx.ranges, *arrays, gradient, slots, numbered=True)
        run_ranges(unpack_range, even_ranges(n, thread_count()), slots, ctx.coefficients, n, *outputs[4:6])
        wanted = zip(ctx.needs_input_grad, gradients, strict=False)
        return *(g if needed else None for needed, g in wanted), None, None


def _geometry_backward(ctx, gradient, slots, gradients, outputs):
    """Gradients of surfels and rays; those of rows are left in the slots."""
    lists, (n, width) = ctx.lists, ctx.rows.shape
    hits = (lists.start, lists.index, lists.weight, lists.distance, lists.left)
    scene = (ctx.record, ctx.rows, ctx.coefficients, ctx.shapes[5][0], ctx.saved_tensors[0].detach().numpy())
    rays = [g.numpy() for g in gradients[6:8]]
    run_ranges(trace_backward_range, ctx.ranges, *ctx.rays, *hits, *scene, gradient, slots, *rays, numbered=True)
    run_ranges(surfel_backward_range, even_ranges(n, thread_count()), slots, width, ctx.record, ctx.quaternion, n, *outputs[:4])


def trace(
    position: torch.Tensor,
    quaternion: torch.Tensor,
    log_scale: torch.Tensor,
    opacity: torch.Tensor,
    sh: torch.Tensor | None,
    extra: torch.Tensor,
    origin: torch.Tensor,
    direction: torch.Tensor,
    tree: Tree,
    degree: int = 3,
) -> torch.Tensor:
    """Composite 2D Gaussians along rays, in the exact order of their hits.

    Args:
        position: (3, N) world; quaternion: (4, N) w x y z, any length; log_scale: (2, N); opacity: (N,) logits.
        sh: (K, 3, N) radiance max(0.5 + sum, 0) in the ray's direction, K >= (degree + 1)^2; None: no colour, zeros.
        extra: (E, N) further channels, E >= 0.
        origin: (R, 3); direction: (R, 3) unit. Hits lie strictly ahead; offsets from a surface are the caller's.
        tree: built from, or refitted to, these very Gaussians. degree: SH degree in use, 0..3.

    Returns:
        (R, 8 + E) sums over hits of weight x (colour 3, unit normal turned against the ray 3, extra E, distance 1), not divided by
        opacity, and opacity itself last (nearly opaque counts as opaque: there the sums are means).

    Raises:
        ValueError: shapes that don't fit, or a tree of other Gaussians (on a device: of other tensors, or of what was in them before).
    """
    _check(origin, direction)
    if not tree.matches(position, quaternion, log_scale, opacity):
        raise ValueError("the tree stands for other Gaussians; refit or rebuild it after they change")
    coefficients = 0 if sh is None else (degree + 1) ** 2
    function = _Trace if isinstance(tree, SurfelTree) else _device().Trace
    return function.apply(position, quaternion, log_scale, opacity, sh, extra, origin, direction, tree, coefficients)


class Seen:
    """What rays see of Gaussians that stay as they are: their rows are laid out once. No gradients.

    Args: tree, sh, extra: as for `trace`, whose degree follows from the coefficients there are.
    """

    def __init__(self, tree: Tree, sh: torch.Tensor, extra: torch.Tensor) -> None:
        self._device = None if isinstance(tree, SurfelTree) else _device().Seen(tree, sh, extra)
        if not isinstance(tree, SurfelTree):
            return
        self._tree, self._extras = tree, len(extra)
        self._coefficients = len(sh)
        self._rows = _pack(sh, extra, self._coefficients)

    def along(self, origin: torch.Tensor, direction: torch.Tensor) -> torch.Tensor:
        """(R, 8 + E), the sums that `trace` returns, for rays (R, 3)."""
        if self._device is not None:
            return self._device.along(origin, direction)
        lists = _numba_lists(self._tree, origin, direction)
        return _composite(self._tree, lists, direction, self._rows, self._coefficients, self._extras)[0]


class _Blend(torch.autograd.Function):
    @staticmethod
    def forward(ctx, values, lists, ray):
        rows = _pack(None, values, 0)
        out = torch.empty(len(ray), len(values))
        ranges = balanced_ranges(np.diff(lists.start)[ray] + 1, thread_count())
        run_ranges(blend_range, ranges, ray, lists.start, lists.index, lists.weight, rows, len(values), out.numpy())
        ctx.lists, ctx.ray, ctx.ranges, ctx.shape = lists, ray, ranges, values.shape
        return out

    @staticmethod
    def backward(ctx, gradient):
        lists, (channels, n) = ctx.lists, ctx.shape
        slots = np.zeros((len(ctx.ranges), n, _whole(channels)), np.float32)
        arrays = (ctx.ray, lists.start, lists.index, lists.weight, gradient.contiguous().numpy(), slots)
        run_ranges(blend_backward_range, ctx.ranges, *arrays, numbered=True)
        out = torch.empty(channels, n)
        run_ranges(unpack_range, even_ranges(n, thread_count()), slots, 0, n, np.empty(0, np.float32), out.view(-1).numpy())
        return out, None, None


def blend(lists: Lists, values: torch.Tensor, rows: torch.Tensor | None = None) -> torch.Tensor:
    """Sums over hits of weight x value, differentiable in the values.

    Args:
        lists: what R rays meet. values: (C, N) channels of the Gaussians. rows: (B,) rays wanted, any order; None: all R.

    Returns:
        (B, C), not divided by opacity.
    """
    if not isinstance(lists, HitLists):
        every = torch.arange(lists.rays, device=values.device) if rows is None else rows.detach().to(torch.int64).contiguous()
        return _device().Blend.apply(values, lists, every)
    ray = np.arange(lists.rays) if rows is None else rows.detach().to(torch.int64).contiguous().numpy()
    return _Blend.apply(values, lists, ray)
