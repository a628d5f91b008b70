# SPDX-License-Identifier: GPL-3.0-or-later
"""BRDF-weighted sums over light samples, differentiable, in one pass: as separate operations they would be limited by memory bandwidth.

In float64 `core/shading/rendering_equation.py` uses its own PyTorch version, `weighted_sums_reference`.
"""

from __future__ import annotations

import torch

from ..machine.backend import by_warp
from ..machine.thread_pool import even_ranges, run_ranges, thread_count
from .cpu.reflection import reflect_backward_range, reflect_range


class _Reflect(torch.autograd.Function):
    """Autograd function of the CPU (numba) backend."""

    @staticmethod
    def forward(ctx, view, normal, alpha, direction, density, incoming):
        tensors = [t.detach().contiguous() for t in (view, normal, alpha, direction, density, incoming)]
        ctx.save_for_backward(*tensors)
        sums = torch.empty(len(view), 9)
        ranges = even_ranges(len(view), 4 * thread_count())
        run_ranges(reflect_range, ranges, *(t.numpy() for t in tensors), sums.numpy())
        return sums.view(-1, 3, 3)

    @staticmethod
    def backward(ctx, gradient):
        tensors = ctx.saved_tensors
        d_point, d_incoming = torch.empty(len(gradient), 7), torch.empty_like(tensors[-1])
        ranges = even_ranges(len(gradient), 4 * thread_count())
        flat = gradient.reshape(-1, 9).contiguous()
        run_ranges(reflect_backward_range, ranges, *(t.numpy() for t in tensors), flat.numpy(), d_point.numpy(), d_incoming.numpy())
        return d_point[:, :3], d_point[:, 3:6], d_point[:, 6], None, None, d_incoming


def weighted_sums(
    view: torch.Tensor, normal: torch.Tensor, alpha: torch.Tensor, direction: torch.Tensor, density: torch.Tensor, incoming: torch.Tensor
) -> torch.Tensor:
    """Average incoming light over samples, weighted for the diffuse lobe and for the two parts of the specular lobe.

    The weights are n.l / q, (n.l / q) D V (1 - w) and (n.l / q) D V w with the Fresnel weight w: diffuse, scaled by F0, added by Fresnel.

    Args:
        view: (P, 3) unit, n.v > 0.
        normal: (P, 3) unit.
        alpha: (P,) GGX width.
        direction: (P, N, 3) unit sample directions, constant.
        density: (P, N) density q of the samples per steradian, constant.
        incoming: (P, N, 3) linear radiance along them. All tensors float32.

    Returns:
        (P, 3 sums, 3 channels), differentiable in view, normal, alpha and incoming.
    """
    arguments = (view, normal, alpha, direction, density, incoming)
    if not by_warp(incoming):
        return _Reflect.apply(*arguments)  # type: ignore[return-value]
    from .warp.weighted_sums import WeightedSums  # Warp is an optional dependency

    return WeightedSums.apply(*arguments)  # type: ignore[return-value]
