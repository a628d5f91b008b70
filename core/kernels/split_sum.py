# SPDX-License-Identifier: GPL-3.0-or-later
"""Deferred split-sum shading of the rasteriser's sums, differentiable; core/rendering/deferred.py defines it in PyTorch."""

from __future__ import annotations

from functools import cache

import numpy as np
import torch

from ..machine.backend import by_warp
from ..machine.thread_pool import balanced_ranges, run_ranges, thread_count
from .cpu.split_sum import shade_backward_range, shade_range


class _Shade(torch.autograd.Function):
    """Autograd function of the CPU (numba) backend; ranges of pixels are balanced by how many of them reflect."""

    @staticmethod
    def forward(ctx, image, stack, rays, rotation, mirrored, tables, thresholds):
        tensors = (image.flatten(1), stack, rays.flatten(1), mirrored.flatten(1))
        x, light, lines, met = (t.detach().contiguous().numpy() for t in tensors)
        out, place = torch.empty(3, *image.shape[1:]), np.empty((2, x.shape[1]), np.float32)
        ranges = balanced_ranges(1 + 9 * (x[-1] > thresholds[0]), thread_count())
        arguments = (x, lines, rotation.numpy(), light, met, *(t.numpy() for t in tables), *thresholds, place)
        run_ranges(shade_range, ranges, *arguments, out.view(3, -1).numpy())
        ctx.arguments, ctx.ranges = arguments, ranges
        return out

    @staticmethod
    def backward(ctx, upstream):
        x, stack = ctx.arguments[0], ctx.arguments[3]
        gradient = torch.empty(len(x), *upstream.shape[1:])
        slots = np.zeros((len(ctx.ranges) if ctx.needs_input_grad[1] else 0, *stack.shape), np.float32)
        flat = upstream.contiguous().view(3, -1).numpy(), gradient.view(len(x), -1).numpy()
        run_ranges(shade_backward_range, ctx.ranges, *ctx.arguments, *flat, slots, numbered=True)
        for other in slots[1:]:
            slots[0] += other
        return gradient, torch.from_numpy(slots[0]) if len(slots) else None, None, None, None, None, None


def shade_pixels(
    image: torch.Tensor,
    rays: torch.Tensor,
    stack: torch.Tensor,
    rotation: torch.Tensor | None,
    tables: tuple[torch.Tensor, torch.Tensor],
    thresholds: tuple[float, float],
    mirrored: torch.Tensor | None = None,
) -> torch.Tensor:
    """Divide the sums of `rasterize` by opacity and add the split-sum reflection of the light, (1 - m) C_sh + S.

    Args:
        image: (13, H, W) float32 sums; the extra channels are albedo (3), roughness, metallic. Without levels in the stack (8 + E, H, W).
        rays: (3, H, W) world directions of any length, without a gradient.
        stack: (L, h, w, 3) float32 prefiltered light; L = 0: nothing reflects.
        rotation: (3, 3) world to the frame of the light, None where it stands still; without a gradient.
        tables: roughness of each level (L,), and scale and bias of F0 in the specular albedo (T, T, 2), on the image's device.
        thresholds: opacity above which a pixel reflects, and the smallest opacity that sums are divided by.
        mirrored: (4, H, W) transmittance along the mirrored direction and radiance of what blocks it, without a gradient; None: nothing
            does.

    Returns:
        (3, H, W) linear radiance with straight alpha.
    """
    turn = _identity(image.device) if rotation is None else rotation.contiguous()
    met = image.new_empty(4, 0, 0) if mirrored is None else mirrored
    if not by_warp(image):
        return _Shade.apply(image, stack, rays, turn, met, tables, thresholds)
    from .warp.split_sum import Shade  # Warp is an optional dependency

    return Shade.apply(image, stack, rays, turn, met, tables, thresholds)


@cache
def _identity(device: torch.device) -> torch.Tensor:
    """Return the (3, 3) rotation of a light that stands still, on a device."""
    return torch.eye(3, device=device)
