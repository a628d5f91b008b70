# SPDX-License-Identifier: GPL-3.0-or-later
"""CPU backend of the ray tracer: numba kernels run over threads and wrapped as autograd functions; called by core/kernels/trace.py."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch

from ...machine.thread_pool import balanced_ranges, even_ranges, run_ranges, thread_count
from ..constants import SURFEL_GRADIENTS
from .adjoint import surfel_backward_range, trace_backward_range
from .bvh import SurfelTree, flat
from .compositing import (
    SH_ROW,
    SUMS,
    blend_backward_range,
    blend_range,
    composite_backward_range,
    composite_range,
    pack_range,
    unpack_range,
)
from .trace import gather_range


@dataclass(frozen=True)
class HitLists:
    """Hits of R rays, each ray's in the order along the ray.

    Attributes:
        start: (R + 1,) int64; the hits of ray r are start[r] : start[r + 1].
        index: (H,) int32 Gaussian of each hit.
        weight: (H,) float32 compositing weight; a ray's weights sum to its opacity, or to 1 where the ray counts as opaque.
        distance: (H,) float32 distance along the ray.
        left: (R,) float32 transmittance behind the last hit, not rounded to 0 where the ray counts as opaque.
    """

    start: np.ndarray
    index: np.ndarray
    weight: np.ndarray
    distance: np.ndarray
    left: np.ndarray

    @property
    def rays(self) -> int:
        """Number of rays, R."""
        return len(self.start) - 1


def hit_lists(tree: SurfelTree, origin: torch.Tensor, direction: torch.Tensor) -> HitLists:
    """List the hits of rays by the numba kernels.

    Args:
        tree: tree over the Gaussians.
        origin: (R, 3) ray origins, world.
        direction: (R, 3) unit directions.

    Returns:
        Hits of the R rays.
    """
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


def _padded_width(channels: int) -> int:
    """Round a number of channels up to whole vectors of 8 floats."""
    return -(-channels // 8) * 8


def pack_rows(sh: torch.Tensor | None, extra: torch.Tensor, coefficients: int) -> np.ndarray:
    """Lay parameters out as one row of floats per Gaussian.

    Args:
        sh: (K, 3, N) SH coefficients; None: rows without colour.
        extra: (E, N) further channels.
        coefficients: number of SH coefficients in use; 0 for none.

    Returns:
        (N, width) float32, see core/kernels/cpu/compositing.py.
    """
    n = extra.shape[1]
    rows = np.empty((n, (SH_ROW if coefficients else 0) + _padded_width(len(extra))), np.float32)
    values = np.empty(0, np.float32) if sh is None else flat(sh)
    run_ranges(pack_range, even_ranges(n, thread_count()), values, flat(extra), coefficients, n, rows)
    return rows


def composite_hits(
    tree: SurfelTree, lists: HitLists, direction: torch.Tensor, rows: np.ndarray, coefficients: int, extras: int
) -> tuple[torch.Tensor, np.ndarray, list[tuple[int, int]]]:
    """Composite hits on the CPU.

    Args:
        tree: tree that the hits come from.
        lists: hits of R rays.
        direction: (R, 3) unit directions.
        rows: (N, width) rows of the Gaussians, from `pack_rows`.
        coefficients: number of SH coefficients, 0 for none.
        extras: number of further channels, E.

    Returns:
        Sums (R, 8 + E); for each hit (H,) a bit mask of the colour channels that their clamp let pass; the ranges of rays per thread.
    """
    out = torch.empty(lists.rays, SUMS + extras)
    lit = np.empty(len(lists.index), np.uint8)
    hits = (lists.start, lists.index, lists.weight, lists.distance, lists.left)
    ranges = balanced_ranges(np.diff(lists.start) + 1, thread_count())
    run_ranges(composite_range, ranges, flat(direction), *hits, tree.record, rows, coefficients, extras, out.numpy(), lit)
    return out, lit, ranges


class Trace(torch.autograd.Function):
    """Autograd function of `core.kernels.trace.trace` on the CPU."""

    @staticmethod
    def forward(ctx, position, quaternion, log_scale, opacity, sh, extra, origin, direction, tree, coefficients):
        """Composite the hits of rays.

        Args:
            ctx: autograd context.
            position: (3, N) centres, world.
            quaternion: (4, N) w x y z.
            log_scale: (2, N) logarithms of the scales.
            opacity: (N,) logits.
            sh: (K, 3, N) SH coefficients or None.
            extra: (E, N) further channels.
            origin: (R, 3) ray origins, world.
            direction: (R, 3) unit directions.
            tree: tree over these Gaussians.
            coefficients: number of SH coefficients in use; 0 for none.

        Returns:
            (R, 8 + E) sums.
        """
        lists = hit_lists(tree, origin, direction)
        rows = pack_rows(sh, extra, coefficients)
        out, lit, ranges = composite_hits(tree, lists, direction, rows, coefficients, len(extra))
        ctx.lists, ctx.lit, ctx.ranges, ctx.rays = lists, lit, ranges, (flat(origin), flat(direction))
        ctx.record, ctx.quaternion, ctx.rows, ctx.coefficients = tree.record, tree.parameters[1], rows, coefficients
        ctx.shapes = [None if p is None else p.shape for p in (position, quaternion, log_scale, opacity, sh, extra, origin, direction)]
        ctx.save_for_backward(out)
        return out

    @staticmethod
    def backward(ctx, gradient):
        """Return the gradients of the inputs from those of the sums, (R, 8 + E)."""
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
        pairs = zip(ctx.needs_input_grad, gradients, strict=False)
        return *(g if needed else None for needed, g in pairs), None, None


def _geometry_backward(ctx, gradient, slots, gradients, outputs):
    """Compute the gradients of surfels and rays; those of the feature rows stay in the slots."""
    lists, (n, width) = ctx.lists, ctx.rows.shape
    hits = (lists.start, lists.index, lists.weight, lists.distance, lists.left)
    scene = (ctx.record, ctx.rows, ctx.coefficients, ctx.shapes[5][0], ctx.saved_tensors[0].detach().numpy())
    rays = [g.numpy() for g in gradients[6:8]]
    run_ranges(trace_backward_range, ctx.ranges, *ctx.rays, *hits, *scene, gradient, slots, *rays, numbered=True)
    run_ranges(surfel_backward_range, even_ranges(n, thread_count()), slots, width, ctx.record, ctx.quaternion, n, *outputs[:4])


class Blend(torch.autograd.Function):
    """Autograd function of `core.kernels.trace.blend` on the CPU."""

    @staticmethod
    def forward(ctx, values, lists, ray):
        """Sum values over hits.

        Args:
            ctx: autograd context.
            values: (C, N) channels of the Gaussians.
            lists: hits of R rays.
            ray: (B,) int64 indices of rays.

        Returns:
            (B, C) weighted sums.
        """
        rows = pack_rows(None, values, 0)
        out = torch.empty(len(ray), len(values))
        ranges = balanced_ranges(np.diff(lists.start)[ray] + 1, thread_count())
        run_ranges(blend_range, ranges, ray, lists.start, lists.index, lists.weight, rows, len(values), out.numpy())
        ctx.lists, ctx.ray, ctx.ranges, ctx.shape = lists, ray, ranges, values.shape
        return out

    @staticmethod
    def backward(ctx, gradient):
        """Return the gradient (C, N) of the values from that of the sums, (B, C)."""
        lists, (channels, n) = ctx.lists, ctx.shape
        slots = np.zeros((len(ctx.ranges), n, _padded_width(channels)), np.float32)
        arrays = (ctx.ray, lists.start, lists.index, lists.weight, gradient.contiguous().numpy(), slots)
        run_ranges(blend_backward_range, ctx.ranges, *arrays, numbered=True)
        out = torch.empty(channels, n)
        run_ranges(unpack_range, even_ranges(n, thread_count()), slots, 0, n, np.empty(0, np.float32), out.view(-1).numpy())
        return out, None, None
