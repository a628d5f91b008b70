# SPDX-License-Identifier: GPL-3.0-or-later
"""Mean over the subpixels of each pixel of an image, and its adjoint."""

from __future__ import annotations

import numpy as np

from .jit import kernel


@kernel
def pool_range(begin, end, fine, stride, plane, subpixels, image):
    """Average k x k = `subpixels`^2 values of `fine` to rows begin..end of `image` (C, H, W).

    fine: channel planes of `plane` floats with rows of `stride` floats, flattened.
    """
    channels, _, width = image.shape
    line = np.empty(width * subpixels, np.float32)
    share = np.float32(1.0 / subpixels**2)
    for channel in range(channels):
        for row in range(begin, end):
            first = channel * plane + row * subpixels * stride
            for x in range(len(line)):
                line[x] = fine[first + x]
            for below in range(1, subpixels):
                for x in range(len(line)):
                    line[x] += fine[first + below * stride + x]
            for x in range(width):
                total = np.float32(0.0)
                for i in range(subpixels):
                    total += line[x * subpixels + i]
                image[channel, row, x] = total * share


@kernel
def spread_range(begin, end, gradient, subpixels, stride, plane, fine):
    """Compute the adjoint of `pool_range`: spread `gradient` (C, H, W) over rows begin..end of `fine`; 0 beyond the image."""
    channels, height, width = gradient.shape
    share = np.float32(1.0 / subpixels**2)
    for channel in range(channels):
        for row in range(begin, end):
            first = channel * plane + row * stride
            inside = width if row < height * subpixels else 0
            for x in range(inside):
                value = gradient[channel, row // subpixels, x] * share
                for i in range(subpixels):
                    fine[first + x * subpixels + i] = value
            fine[first + inside * subpixels : first + stride] = 0.0
