# SPDX-License-Identifier: GPL-3.0-or-later
"""Loss of an image with a mask and its gradient on the GPU, a thread per pixel; formulas as in core/kernels/cpu/image_loss.py."""

import torch
import warp as wp

from ..constants import SSIM_WEIGHT
from .normal_consistency import consistency_gradient
from .photometric import photometric_gradient
from .runtime import launch

# The sRGB curve of core/io/srgb.py, which this kernel is tested against: a line up to _LINEAR.
_LINEAR, _SLOPE, _SCALE, _SHIFT, _POWER = (wp.constant(c) for c in (0.0031308, 12.92, 1.055, 0.055, 2.4))
_CLIPPED = wp.constant(-1.0)  # in place of an encoded value: the pixel shows its bound and has no gradient


@wp.kernel
def encode(
    straight: wp.array(dtype=float), alpha: wp.array(dtype=float), limit: wp.array(dtype=float), saturated: wp.array(dtype=wp.bool),
    pixels: int, encoded: wp.array(dtype=float), image: wp.array(dtype=float),
):  # fmt: skip
    """Encode values of `straight` (3 P,) to `encoded` (3 P,), and composite them over black to `image` (3 P,), clipped at `limit` (P,)."""
    i = wp.tid()
    p = i % pixels
    linear = straight[i]
    value = _SCALE * wp.pow(linear, 1.0 / _POWER) - _SHIFT  # NaN stays visible
    if linear <= _LINEAR:
        value = wp.max(linear, 0.0) * _SLOPE
    shown = value * alpha[p]
    if saturated[i] and shown > limit[p]:
        value = _CLIPPED
        shown = limit[p]
    encoded[i] = value
    image[i] = shown


@wp.func
def slope(linear: float, encoded: float) -> float:
    """Return the derivative of the sRGB curve."""
    if linear <= _LINEAR:
        return wp.where(linear < 0.0, 0.0, _SLOPE)
    return (encoded + _SHIFT) / (linear * _POWER)


@wp.kernel
def encode_backward(
    straight: wp.array(dtype=float), alpha: wp.array(dtype=float), mask: wp.array(dtype=float), encoded: wp.array(dtype=float),
    g_image: wp.array(dtype=float), mask_weight: float, normal_cost: wp.array(dtype=float), pixels: int, cost: wp.array(dtype=float),
    g_straight: wp.array(dtype=float), g_alpha: wp.array(dtype=float),
):  # fmt: skip
    """Compute the adjoint of `encode`; add the difference from the mask and the cost of normals to the cost of each pixel's red, (3 P,).

    g_image: (3 P,) gradient of the photometric loss. g_alpha: (P,) gradient of the other losses by opacity, which is added to.
    """
    p = wp.tid()
    a = alpha[p]
    difference = a - mask[p]
    total = g_alpha[p]
    if difference > 0.0:
        total += mask_weight
    if difference < 0.0:
        total -= mask_weight
    for channel in range(3):
        i = channel * pixels + p
        g = wp.where(encoded[i] < 0.0, 0.0, g_image[i])
        total += g * encoded[i]
        g_straight[i] = g * a * slope(straight[i], encoded[i])
    g_alpha[p] = total
    cost[p] += mask_weight * wp.abs(difference) + normal_cost[p]


class MaskedLoss(torch.autograd.Function):
    """Autograd function of core/kernels/image_loss.py on the GPU; the forward pass computes the gradient too."""

    @staticmethod
    def forward(ctx, straight, sums, target):
        """Compute the loss and its gradients.

        Args:
            ctx: autograd context.
            straight: (3, H, W) linear radiance with straight alpha.
            sums: (C, H, W) of the rasteriser.
            target: `MaskedTarget`.

        Returns:
            Scalar loss.
        """
        shaded, x, mask = straight.detach().contiguous(), sums.detach().contiguous(), target.mask.contiguous()
        encoded, image, pixels = torch.empty_like(shaded), torch.empty_like(shaded), mask.numel()
        launch(encode, 3 * pixels, shaded, x[-1], mask, target.saturated.contiguous(), pixels, encoded, image)
        cost, g_image = photometric_gradient(image, target.image.contiguous(), SSIM_WEIGHT, target.scale)
        weight = target.scale * target.normal_weight
        normal_cost, g_sums = consistency_gradient(x, target.rays, target.rotation, target.edge, weight)
        g_straight, mask_weight = torch.empty_like(shaded), target.scale * target.mask_weight / pixels
        inputs = (shaded, x[-1], mask, encoded, g_image, mask_weight, normal_cost, pixels)
        launch(encode_backward, pixels, *inputs, cost, g_straight, g_sums[-1])
        ctx.save_for_backward(g_straight, g_sums)
        return cost.sum()

    @staticmethod
    def backward(ctx, upstream):
        """Return the gradients of radiance (3, H, W) and sums (C, H, W) from that of the loss."""
        return *(upstream * gradient for gradient in ctx.saved_tensors), None
