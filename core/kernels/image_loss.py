# SPDX-License-Identifier: GPL-3.0-or-later
"""Loss of an image of an object with a mask and its gradient, fused; core/stages/common/image_loss.py defines it in PyTorch."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch

from ..machine.backend import by_warp
from ..machine.thread_pool import even_ranges, run_ranges, thread_count
from .constants import SSIM_WEIGHT
from .cpu.image_loss import encode_backward_range, encode_range
from .normal_consistency import consistency_gradient
from .photometric import photometric_gradient

MIN_PIXELS = 8  # lanes of one vector of the CPU's kernels


@dataclass(frozen=True)
class MaskedTarget:
    """What an image is compared with.

    Attributes:
        image: (3, H, W) sRGB-encoded, on black.
        mask: (H, W) opacity.
        saturated: (3, H, W) bool, values that are lower bounds.
        rays: (3, H, W) camera rays with z = 1.
        rotation: (3, 3) world to camera (OpenCV axes).
        mask_weight: weight of the mean difference from the mask.
        normal_weight: weight of the normal consistency.
        edge: see `normal_consistency`.
        scale: factor of the whole loss.
    """

    image: torch.Tensor
    mask: torch.Tensor
    saturated: torch.Tensor
    rays: torch.Tensor
    rotation: torch.Tensor
    mask_weight: float
    normal_weight: float
    edge: float
    scale: float


class _MaskedLoss(torch.autograd.Function):
    """Autograd function of the CPU (numba) backend; the forward pass computes the gradient too."""

    @staticmethod
    def forward(ctx, straight, sums, target):
        shaded, x = straight.detach().contiguous().numpy(), sums.detach().contiguous().numpy()
        mask, pixels = target.mask.numpy(), target.mask.numel()
        encoded, image = np.empty_like(shaded), np.empty_like(shaded)
        flat = shaded.reshape(-1), x[-1].reshape(-1), mask.reshape(-1)
        blocks = even_ranges(-(-pixels // 8), thread_count())
        run_ranges(encode_range, blocks, pixels, *flat, target.saturated.numpy().reshape(-1), encoded.reshape(-1), image.reshape(-1))
        photometric, g_image = photometric_gradient(image, target.image.numpy(), SSIM_WEIGHT)
        normals, g_normals = consistency_gradient(x, target.rays.numpy(), target.rotation.numpy(), target.edge)
        g_straight, g_sums = np.empty_like(shaded), np.empty_like(x)
        weights = (np.float32(w) for w in (target.mask_weight / pixels, target.normal_weight, target.scale))
        inputs = (*flat, encoded.reshape(-1), g_image.reshape(-1), g_normals.reshape(-1), *weights)
        run_ranges(encode_backward_range, blocks, pixels, *inputs, g_straight.reshape(-1), g_sums.reshape(-1))
        ctx.save_for_backward(torch.from_numpy(g_straight), torch.from_numpy(g_sums))
        loss = photometric + target.mask_weight * np.abs(x[-1] - mask).mean(dtype=np.float64) + target.normal_weight * normals
        return torch.tensor(target.scale * loss, dtype=sums.dtype)

    @staticmethod
    def backward(ctx, upstream):
        return *(upstream * gradient for gradient in ctx.saved_tensors), None


def masked_loss(straight: torch.Tensor, sums: torch.Tensor, target: MaskedTarget) -> torch.Tensor:
    """Compute the photometric loss, the difference from the mask and the normal consistency of an image over black.

    Args:
        straight: (3, H, W) float32 linear radiance with straight alpha, of at least MIN_PIXELS pixels.
        sums: (C, H, W) float32 sums of `rasterize`; the gradient of the straight radiance is not part of theirs.
        target: image to match, on the same device, and weights.

    Returns:
        Scalar loss.
    """
    if not by_warp(sums):
        return _MaskedLoss.apply(straight, sums, target)
    from .warp.image_loss import MaskedLoss  # Warp is an optional dependency

    return MaskedLoss.apply(straight, sums, target)
