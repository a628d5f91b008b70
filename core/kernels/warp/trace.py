# SPDX-License-Identifier: GPL-3.0-or-later
"""Ray tracer of 2D Gaussians on the GPU, wrapped as autograd functions; called by core/kernels/trace.py."""

from __future__ import annotations

import torch

from ..constants import SURFEL_GRADIENTS
from . import adjoint, surfels
from .hit_lists import DeviceLists, by_gaussian
from .runtime import launch
from .tree import DeviceTree

SUMS = 8  # outputs besides the extras


def _composite_rays(tree: DeviceTree, origin, direction, sh: torch.Tensor, coefficients: int, extra: torch.Tensor):
    """Composite rays; return sums (R, 8 + E), number of hits (R,) and transmittance (R,); rows: sh (N, 3, K), extra (N, E)."""
    rays, extras, device = len(origin), extra.shape[1], origin.device
    out, left = torch.zeros(rays, SUMS + extras, device=device), torch.ones(rays, device=device)
    count = torch.zeros(rays, dtype=torch.int64, device=device)
    if rays and len(tree.record):
        rows = (sh, coefficients, extra)
        launch(surfels.composite(extras), rays, *tree.layout, tree.record, origin, direction, *rows, out, count, left)
    return out, count, left


def _collect_hits(tree: DeviceTree, origin, direction, count: torch.Tensor, left: torch.Tensor) -> DeviceLists:
    """Collect the counted hits of rays. The host waits for their number."""
    device = origin.device
    start = torch.cat([torch.zeros(1, dtype=torch.int64, device=device), torch.cumsum(count, 0)])
    total, longest = (int(x) for x in torch.stack([start[-1], count.max() if len(count) else start[-1]]).cpu().tolist())
    index, of = torch.empty(2, total, dtype=torch.int32, device=device)
    weight, distance = torch.empty(2, total, device=device)
    if total:
        launch(surfels.gather, len(count), *tree.layout, tree.record, origin, direction, start, index, weight, distance, of)
    return DeviceLists(start, index, weight, distance, left, of, longest)


def hit_lists(tree: DeviceTree, origin: torch.Tensor, direction: torch.Tensor) -> DeviceLists:
    """List the hits of rays, see core/kernels/trace.py.

    Args:
        tree: tree over the Gaussians.
        origin: (R, 3) ray origins, world.
        direction: (R, 3) unit directions.
    """
    origin, direction = origin.detach().contiguous(), direction.detach().contiguous()
    nothing = torch.empty(len(tree.record), 0, device=origin.device)
    _, count, left = _composite_rays(tree, origin, direction, nothing, 0, nothing)
    return _collect_hits(tree, origin, direction, count, left)


def transmittance(tree: DeviceTree, origin: torch.Tensor, direction: torch.Tensor) -> torch.Tensor:
    """Compute the fraction of light that passes along rays, see core/kernels/trace.py.

    Args:
        tree: tree over the Gaussians.
        origin: (R, 3) ray origins, world.
        direction: (R, 3) unit directions.

    Returns:
        (R,) transmittance.
    """
    through = torch.ones(len(origin), device=origin.device)
    if len(origin) and len(tree.record):
        rays = (origin.detach().contiguous(), direction.detach().contiguous())
        launch(surfels.pass_through, len(origin), tree.id, tree.record, *rays, through)
    return through


def rows_of(sh: torch.Tensor | None, extra: torch.Tensor, coefficients: int) -> tuple[torch.Tensor, torch.Tensor]:
    """Lay parameters out as rows of Gaussians.

    Args:
        sh: (K, 3, N) SH coefficients or None.
        extra: (E, N) further channels.
        coefficients: number of SH coefficients in use, K'.

    Returns:
        (N, 3, K') and (N, E).
    """
    coloured = extra.new_empty(extra.shape[1], 3, 0) if sh is None else sh.detach()[:coefficients].permute(2, 1, 0).contiguous()
    return coloured, extra.detach().T.contiguous()


class Trace(torch.autograd.Function):
    """Autograd function of core/kernels/trace.py on the GPU.

    In the backward pass the host waits once for the number of hits; `Blend`, over known hits, never does.
    """

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
        rays, rows = (origin.detach().contiguous(), direction.detach().contiguous()), rows_of(sh, extra, coefficients)
        out, count, left = _composite_rays(tree, *rays, rows[0], coefficients, rows[1])
        ctx.tree, ctx.rays, ctx.rows, ctx.coefficients, ctx.hits = tree, rays, rows, coefficients, (count, left)
        ctx.record, ctx.quaternion = tree.record.clone() if any(ctx.needs_input_grad[:4]) else tree.record, quaternion.detach().contiguous()
        ctx.shapes = [None if p is None else p.shape for p in (position, quaternion, log_scale, opacity, sh, extra, origin, direction)]
        ctx.save_for_backward(out)
        return out

    @staticmethod
    def backward(ctx, gradient):
        """Return the gradients of the inputs from those of the sums, (R, 8 + E)."""
        gradient, device, n = gradient.contiguous(), gradient.device, len(ctx.record)
        gradients = [None if shape is None else torch.zeros(shape, device=device) for shape in ctx.shapes]
        lists = _collect_hits(ctx.tree, *ctx.rays, *ctx.hits)
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
        pairs = zip(ctx.needs_input_grad, gradients, strict=False)
        return *(g if needed else None for needed, g in pairs), None, None


class FrozenGaussians:
    """Renderer of constant Gaussians along rays, see core/kernels/trace.py; it never makes the host wait.

    Args:
        tree: tree over the N Gaussians.
        sh: (K, 3, N) SH coefficients.
        extra: (E, N) further channels.
    """

    def __init__(self, tree: DeviceTree, sh: torch.Tensor, extra: torch.Tensor) -> None:
        self._tree, self._coefficients = tree, len(sh)
        self._rows = rows_of(sh, extra, len(sh))

    def along(self, origin: torch.Tensor, direction: torch.Tensor) -> torch.Tensor:
        """Composite the Gaussians along rays.

        Args:
            origin: (R, 3) ray origins, world.
            direction: (R, 3) unit directions.

        Returns:
            (R, 8 + E) sums.
        """
        rays = (origin.detach().contiguous(), direction.detach().contiguous())
        return _composite_rays(self._tree, *rays, self._rows[0], self._coefficients, self._rows[1])[0]


class Blend(torch.autograd.Function):
    """Autograd function of `blend` in core/kernels/trace.py on the GPU."""

    @staticmethod
    def forward(ctx, values, lists, ray):
        """Sum values over known hits.

        Args:
            ctx: autograd context.
            values: (C, N) channels of the Gaussians.
            lists: hits of R rays.
            ray: (B,) int64 indices of rays.

        Returns:
            (B, C) weighted sums.
        """
        out = torch.zeros(len(ray), len(values), device=values.device)
        if len(lists.index):
            launch(surfels.blend, out.shape, ray, lists.start, lists.index, lists.weight, values.detach().contiguous(), out)
        ctx.lists, ctx.ray, ctx.shape = lists, ray, values.shape
        return out

    @staticmethod
    def backward(ctx, gradient):
        """Return the gradient (C, N) of the values from that of the sums, (B, C)."""
        lists, ray, (channels, n) = ctx.lists, ctx.ray, ctx.shape
        out = torch.zeros(channels, n, device=gradient.device)
        if len(lists.index) and len(ray):
            padded = torch.empty(len(ray), lists.longest, dtype=torch.int32, device=gradient.device)
            launch(adjoint.pad_hits, padded.shape, ray, lists.start, lists.index, lists.longest, n, padded)
            order, first = by_gaussian(padded.view(-1), n)
            arrays = (order, first, ray, lists.start, lists.longest, lists.weight, gradient.contiguous(), out)
            launch(adjoint.blend_backward, (channels, n), *arrays)
        return out, None, None
