# SPDX-License-Identifier: GPL-3.0-or-later
"""Mean over the subpixels of each pixel of an image, and its adjoint."""

from __future__ import annotations

import numpy as np

from .jit import kernel
from .simd import load, splat, store


@kernel
def pool_range(begin, end, fine, stride, plane, subpixels, image):
    """Average k x k = `subpixels`^2 values of `fine` to rows begin..end of `image` (C, H, W).

    fine: channel planes of `plane` floats with rows of `stride` floats, whole vectors, flattened.
    """
    channels, _, width = image.shape
    line = np.empty(stride, np.float32)
    share = np.float32(1.0 / subpixels**2)
    for channel in range(channels):
        for row in range(begin, end):
            first = channel * plane + row * subpixels * stride
            for x in range(0, width * subpixels, 8):
                value = load(fine, first + x)
                for below in range(1, subpixels):
                    value = value + load(fine, first + below * stride + x)
                store(line, x, value * share)
            for x in range(width):
                total = line[x * subpixels]
                for i in range(1, subpixels):
                    total += line[x * subpixels + i]
                image[channel, row, x] = total


@kernel
def spread_range(begin, end, gradient, subpixels, stride, plane, fine):
    """Compute the adjoint of `pool_range`: spread rows begin..end of `gradient` (C, H, W) over `fine`; 0 beyond the image.

    `end` may exceed H: up to the number of rows that all of `fine` is the image of.
    """
    channels, height, width = gradient.shape
    line = np.zeros(stride, np.float32)
    share = np.float32(1.0 / subpixels**2)
    for channel in range(channels):
        for row in range(begin, end):
            if row < height:
                for x in range(width):
                    value = gradient[channel, row, x] * share
                    for i in range(subpixels):
                        line[x * subpixels + i] = value
            for below in range(row * subpixels, min((row + 1) * subpixels, plane // stride)):
                first = channel * plane + below * stride
                for x in range(0, stride, 8):
                    store(fine, first + x, load(line, x) if row < height else splat(0.0))
