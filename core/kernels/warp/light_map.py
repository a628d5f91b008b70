# SPDX-License-Identifier: GPL-3.0-or-later
"""Variation of a light map with its gradient on the GPU, a thread per value; core/stages/common/light_map.py defines it in PyTorch."""

import torch
import warp as wp

from .runtime import launch


@wp.func
def cost(difference: float, edge: float) -> float:
    """Return c^2 log(1 + (d / c)^2), accurate for small d too (Kahan's log1p)."""
    x2 = (difference / edge) * (difference / edge)
    one = 1.0 + x2
    if one == 1.0:
        return edge * edge * x2
    return edge * edge * wp.log(one) * (x2 / (one - 1.0))


@wp.func
def pull(difference: float, edge: float) -> float:
    """Return the derivative of the cost."""
    x = difference / edge
    return 2.0 * difference / (1.0 + x * x)


@wp.kernel
def vary(
    light: wp.array3d(dtype=float),
    edge: float,
    across: float,
    down: float,
    value: wp.array3d(dtype=float),
    gradient: wp.array3d(dtype=float),
):
    """Compute the cost of each value against its left and upper neighbours, and the gradient of all costs, both (H, W, C).

    across, down: weights of a pair along a row, which wraps around, and along a column.
    """
    i, j, k = wp.tid()
    height, width = light.shape[0], light.shape[1]
    here = light[i, j, k]
    left, right = here - light[i, (j + width - 1) % width, k], here - light[i, (j + 1) % width, k]
    total, slope = across * cost(left, edge), across * (pull(left, edge) + pull(right, edge))
    if i > 0:
        above = here - light[i - 1, j, k]
        total += down * cost(above, edge)
        slope += down * pull(above, edge)
    if i < height - 1:
        slope += down * pull(here - light[i + 1, j, k], edge)
    value[i, j, k] = total
    gradient[i, j, k] = slope


class LightVariation(torch.autograd.Function):
    """Autograd function of `light_variation` on the GPU; the forward pass computes the gradient too."""

    @staticmethod
    def forward(ctx, log_light, edge):
        """Compute the variation.

        Args:
            ctx: autograd context.
            log_light: (H, W, C) log radiance, H >= 2.
            edge: difference between two texels that counts as an edge.

        Returns:
            Scalar variation.
        """
        light = log_light.detach().contiguous()
        value, gradient = torch.empty_like(light), torch.empty_like(light)
        launch(vary, light.shape, light, edge, 1 / light.numel(), 1 / light[1:].numel(), value, gradient)
        ctx.save_for_backward(gradient)
        return value.sum()

    @staticmethod
    def backward(ctx, upstream):
        """Return the gradient (H, W, C) of the light map from that of the variation."""
        return upstream * ctx.saved_tensors[0], None
