# SPDX-License-Identifier: GPL-3.0-or-later
"""L1 + D-SSIM of two pictures with its analytic gradient, fused: torch's convolutions take 20 times as long.

SSIM as published (Wang 2004): 11 x 11 Gaussian window of sigma 1.5, zeros outside the picture.
"""

from __future__ import annotations

import numpy as np
import torch

from .backend import by_warp
from .jit import kernel
from .pool import even_ranges, run_ranges, thread_count
from .simd import load, splat, store

RADIUS = 5
_taps = np.exp(-0.5 * (np.arange(-RADIUS, RADIUS + 1) / 1.5) ** 2)
TAPS = (_taps / _taps.sum()).astype(np.float32)
C1, C2 = np.float32(0.01**2), np.float32(0.03**2)


@kernel
def _blur_columns(rows, first, count, stride, width, taps, out):
    """Vertical pass over `count` + 10 horizontally blurred rows of one quantity, for output row `first`."""
    for x in range(0, width, 8):
        value = splat(np.float32(0.0))
        for k in range(2 * RADIUS + 1):
            value = value + load(rows, (first + k) * stride + x) * taps[k]
        store(out, x, value)


@kernel
def _blur_row(padded, width, taps, out, at):
    """Horizontal pass: `padded` has 8 zeros before and at least 8 after its `width` values."""
    for x in range(0, width, 8):
        value = splat(np.float32(0.0))
        for k in range(2 * RADIUS + 1):
            value = value + load(padded, x + 8 - RADIUS + k) * taps[k]
        store(out, at + x, value)


@kernel
def _statistics_rows(x, y, channel, begin, end, height, width, taps, blurred):
    """Horizontally blurred x, y, xx, yy, xy of rows begin - 5 .. end + 5."""
    stride = (width + 7) // 8 * 8
    size = (end - begin + 2 * RADIUS) * stride
    row_a, row_b = np.zeros(stride + 24, np.float32), np.zeros(stride + 24, np.float32)
    product = np.zeros(stride + 24, np.float32)
    for i in range(end - begin + 2 * RADIUS):
        row = begin - RADIUS + i
        inside = 0 <= row < height
        for j in range(width):
            row_a[8 + j] = x[channel, row, j] if inside else 0.0
            row_b[8 + j] = y[channel, row, j] if inside else 0.0
        _blur_row(row_a, width, taps, blurred, i * stride)
        _blur_row(row_b, width, taps, blurred, size + i * stride)
        for j in range(width):
            product[8 + j] = row_a[8 + j] * row_a[8 + j]
        _blur_row(product, width, taps, blurred, 2 * size + i * stride)
        for j in range(width):
            product[8 + j] = row_b[8 + j] * row_b[8 + j]
        _blur_row(product, width, taps, blurred, 3 * size + i * stride)
        for j in range(width):
            product[8 + j] = row_a[8 + j] * row_b[8 + j]
        _blur_row(product, width, taps, blurred, 4 * size + i * stride)


@kernel
def similarity_range(begin, end, x, y, taps, slopes, sums):
    """SSIM of rows begin..end: its sum per channel and row, and d ssim / d (mean x, mean xx, mean xy) as planes."""
    channels, height, width = x.shape
    stride = (width + 7) // 8 * 8
    rows = end - begin + 2 * RADIUS
    size = rows * stride
    blurred = np.empty(5 * size, np.float32)
    mean = np.empty((5, stride), np.float32)
    for channel in range(channels):
        _statistics_rows(x, y, channel, begin, end, height, width, taps, blurred)
        for row in range(begin, end):
            for q in range(5):
                _blur_columns(blurred[q * size : (q + 1) * size], row - begin, rows, stride, width, taps, mean[q])
            total = np.float32(0.0)
            for j in range(width):
                mx, my = mean[0, j], mean[1, j]
                a1, a2 = 2 * mx * my + C1, 2 * (mean[4, j] - mx * my) + C2
                b1 = mx * mx + my * my + C1
                b2 = max(mean[2, j] - mx * mx, np.float32(0)) + max(mean[3, j] - my * my, np.float32(0)) + C2
                ssim = a1 * a2 / (b1 * b2)
                total += ssim
                slopes[0, channel, row, j] = 2 * my * (a2 - a1) / (b1 * b2) + 2 * mx * ssim * (1 / b2 - 1 / b1)
                slopes[1, channel, row, j] = -ssim / b2
                slopes[2, channel, row, j] = 2 * a1 / (b1 * b2)
            sums[channel, row] = total


@kernel
def gradient_range(begin, end, x, y, taps, slopes, l1_weight, ssim_weight, gradient):
    """d loss / d x of rows begin..end, the SSIM part from the blurred slopes."""
    channels, height, width = x.shape
    stride = (width + 7) // 8 * 8
    rows = end - begin + 2 * RADIUS
    size = rows * stride
    blurred = np.empty(3 * size, np.float32)
    padded = np.zeros(stride + 24, np.float32)
    mean = np.empty((3, stride), np.float32)
    for channel in range(channels):
        for i in range(rows):
            row = begin - RADIUS + i
            for q in range(3):
                for j in range(width):
                    padded[8 + j] = slopes[q, channel, row, j] if 0 <= row < height else 0.0
                _blur_row(padded, width, taps, blurred, q * size + i * stride)
        for row in range(begin, end):
            for q in range(3):
                _blur_columns(blurred[q * size : (q + 1) * size], row - begin, rows, stride, width, taps, mean[q])
            for j in range(width):
                a, b = x[channel, row, j], y[channel, row, j]
                sign = np.float32(1.0) if a > b else (np.float32(-1.0) if a < b else np.float32(0.0))
                gradient[channel, row, j] = l1_weight * sign - ssim_weight * (mean[0, j] + 2 * a * mean[1, j] + b * mean[2, j])


class _Photometric(torch.autograd.Function):
    @staticmethod
    def forward(ctx, picture, truth, ssim_share):
        x, y = picture.detach().contiguous().numpy(), truth.contiguous().numpy()
        _, height, _ = x.shape
        slopes = np.empty((3, *x.shape), np.float32)
        sums = np.empty(x.shape[:2], np.float32)
        gradient = torch.empty(x.shape)
        ranges = even_ranges(height, thread_count())
        run_ranges(similarity_range, ranges, x, y, TAPS, slopes, sums)
        weights = np.float32((1 - ssim_share) / x.size), np.float32(ssim_share / x.size)
        run_ranges(gradient_range, ranges, x, y, TAPS, slopes, *weights, gradient.numpy())
        ctx.save_for_backward(gradient)
        ssim = sums.sum(dtype=np.float64) / x.size
        return torch.tensor((1 - ssim_share) * np.abs(x - y).mean(dtype=np.float64) + ssim_share * (1 - ssim), dtype=picture.dtype)

    @staticmethod
    def backward(ctx, upstream):
        return upstream * ctx.saved_tensors[0], None, None


def photometric_loss(picture: torch.Tensor, truth: torch.Tensor, ssim_share: float = 0.2) -> torch.Tensor:
    """(1 - s) mean |x - y| + s (1 - mean SSIM) of (C, H, W) float32 pictures in 0..1; differentiable in the first."""
    if not by_warp(picture):
        return _Photometric.apply(picture, truth, ssim_share)
    from .warp.photometric import Photometric  # an option, not installed everywhere

    return Photometric.apply(picture, truth, ssim_share)
