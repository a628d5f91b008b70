# SPDX-License-Identifier: GPL-3.0-or-later
"""CPU kernels of L1 + D-SSIM and its analytic gradient, fused: torch's convolutions take 20 times as long.

See core/kernels/photometric.py.
"""

from __future__ import annotations

import numpy as np

from ..constants import SSIM_C1, SSIM_C2, SSIM_RADIUS
from .jit import helper, kernel
from .simd import load, splat, store


@helper
def _blur_columns(rows, first, count, stride, width, taps, out):
    """Blur vertically: reduce horizontally blurred rows first..first + 10 of one quantity (count + 10 rows) to `out` (stride,)."""
    for x in range(0, width, 8):
        value = splat(np.float32(0.0))
        for k in range(2 * SSIM_RADIUS + 1):
            value = value + load(rows, (first + k) * stride + x) * taps[k]
        store(out, x, value)


@helper
def _blur_row(padded, width, taps, out, at):
    """Blur horizontally; `padded` has 8 zeros before and at least 8 after its `width` values."""
    for x in range(0, width, 8):
        value = splat(np.float32(0.0))
        for k in range(2 * SSIM_RADIUS + 1):
            value = value + load(padded, x + 8 - SSIM_RADIUS + k) * taps[k]
        store(out, at + x, value)


@helper
def _statistics_rows(x, y, channel, begin, end, height, width, taps, blurred):
    """Blur x, y, xx, yy, xy of rows begin - 5 .. end + 5 horizontally into `blurred` (5 x rows x stride,)."""
    stride = (width + 7) // 8 * 8
    size = (end - begin + 2 * SSIM_RADIUS) * stride
    row_a, row_b = np.zeros(stride + 24, np.float32), np.zeros(stride + 24, np.float32)
    product = np.zeros(stride + 24, np.float32)
    for i in range(end - begin + 2 * SSIM_RADIUS):
        row = begin - SSIM_RADIUS + i
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
    """Compute the SSIM of rows begin..end: its sum per channel and row, (C, H), and d ssim / d (mean x, mean xx, mean xy), (3, C, H, W)."""
    channels, height, width = x.shape
    stride = (width + 7) // 8 * 8
    rows = end - begin + 2 * SSIM_RADIUS
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
                a1, a2 = 2 * mx * my + SSIM_C1, 2 * (mean[4, j] - mx * my) + SSIM_C2
                b1 = mx * mx + my * my + SSIM_C1
                b2 = max(mean[2, j] - mx * mx, np.float32(0)) + max(mean[3, j] - my * my, np.float32(0)) + SSIM_C2
                ssim = a1 * a2 / (b1 * b2)
                total += ssim
                slopes[0, channel, row, j] = 2 * my * (a2 - a1) / (b1 * b2) + 2 * mx * ssim * (1 / b2 - 1 / b1)
                slopes[1, channel, row, j] = -ssim / b2
                slopes[2, channel, row, j] = 2 * a1 / (b1 * b2)
            sums[channel, row] = total


@kernel
def gradient_range(begin, end, x, y, taps, slopes, l1_weight, ssim_weight, gradient):
    """Compute d loss / d x (C, H, W) of rows begin..end, the SSIM part from the blurred slopes."""
    channels, height, width = x.shape
    stride = (width + 7) // 8 * 8
    rows = end - begin + 2 * SSIM_RADIUS
    size = rows * stride
    blurred = np.empty(3 * size, np.float32)
    padded = np.zeros(stride + 24, np.float32)
    mean = np.empty((3, stride), np.float32)
    for channel in range(channels):
        for i in range(rows):
            row = begin - SSIM_RADIUS + i
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
