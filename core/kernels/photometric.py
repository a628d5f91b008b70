# SPDX-License-Identifier: GPL-3.0-or-later
"""Photometric loss L1 + D-SSIM of two images, differentiable, on the CPU or a GPU.

SSIM as published (Wang et al. 2004): 11 x 11 Gaussian window of sigma 1.5, zeros outside the image.
"""

from __future__ import annotations

import numpy as np
import torch

from ..machine.backend import by_warp
from ..machine.thread_pool import even_ranges, run_ranges, thread_count
from .constants import SSIM_TAPS, SSIM_WEIGHT
from .cpu.photometric import gradient_range, similarity_range


class _Photometric(torch.autograd.Function):
    """Autograd function of the CPU (numba) backend; the forward pass computes the gradient too."""

    @staticmethod
    def forward(ctx, image, target, ssim_weight):
        value, gradient = photometric_gradient(image.detach().contiguous().numpy(), target.contiguous().numpy(), ssim_weight)
        ctx.save_for_backward(torch.from_numpy(gradient))
        return torch.tensor(value, dtype=image.dtype)

    @staticmethod
    def backward(ctx, upstream):
        return upstream * ctx.saved_tensors[0], None, None


def photometric_gradient(x: np.ndarray, y: np.ndarray, ssim_weight: float) -> tuple[float, np.ndarray]:
    """Compute the loss of an image x against y, both (C, H, W) float32, and its gradient by x, (C, H, W), on the CPU."""
    slopes, sums, gradient = np.empty((3, *x.shape), np.float32), np.empty(x.shape[:2], np.float32), np.empty_like(x)
    ranges = even_ranges(x.shape[1], thread_count())
    run_ranges(similarity_range, ranges, x, y, SSIM_TAPS, slopes, sums)
    weights = np.float32((1 - ssim_weight) / x.size), np.float32(ssim_weight / x.size)
    run_ranges(gradient_range, ranges, x, y, SSIM_TAPS, slopes, *weights, gradient)
    ssim = sums.sum(dtype=np.float64) / x.size
    return (1 - ssim_weight) * np.abs(x - y).mean(dtype=np.float64) + ssim_weight * (1 - ssim), gradient


def photometric_loss(image: torch.Tensor, target: torch.Tensor, ssim_weight: float = SSIM_WEIGHT) -> torch.Tensor:
    """Compute (1 - s) mean |x - y| + s (1 - mean SSIM), differentiable in the first image.

    Args:
        image: (C, H, W) float32 rendered image x in 0..1.
        target: (C, H, W) float32 image y to match, in 0..1.
        ssim_weight: s in 0..1.

    Returns:
        Scalar loss.
    """
    if not by_warp(image):
        return _Photometric.apply(image, target, ssim_weight)
    from .warp.photometric import Photometric  # Warp is an optional dependency

    return Photometric.apply(image, target, ssim_weight)
