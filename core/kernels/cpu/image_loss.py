# SPDX-License-Identifier: GPL-3.0-or-later
"""CPU kernels that encode and composite an image, and their adjoint, 8 pixels to a vector; see core/kernels/image_loss.py."""

from __future__ import annotations

import math

import numpy as np

from .jit import helper, kernel
from .simd import load, maximum, select, splat, store
from .simd_math import exp, log2

# The sRGB curve of core/io/srgb.py, which this kernel is tested against: a line up to _LINEAR.
_LINEAR, _SLOPE, _SCALE, _SHIFT, _POWER = (np.float32(c) for c in (0.0031308, 12.92, 1.055, 0.055, 2.4))
_LN2_OVER_POWER = np.float32(math.log(2) / 2.4)
_CLIPPED = np.float32(-1.0)  # in place of an encoded value: the pixel shows its bound and has no gradient


@helper
def _encoded(linear):
    """Encode 8 linear values by the sRGB curve."""
    power = exp(log2(maximum(linear, splat(_LINEAR))) * _LN2_OVER_POWER) * _SCALE - _SHIFT
    power = select(linear < np.float32(3e38), power, linear)  # NaN and infinity stay visible
    return select(linear <= _LINEAR, maximum(linear, splat(0.0)) * _SLOPE, power)


@kernel
def encode_range(begin, end, pixels, straight, alpha, limit, saturated, encoded, image):
    """Encode blocks begin..end of 8 pixels of `straight` (3 P,) to `encoded` (3 P,), and composite them over black to `image` (3 P,).

    Saturated pixels (3 P,) are clipped at `limit` (P,). The last block overlaps its neighbour where P is no multiple of 8.
    """
    for block in range(begin, end):
        first = min(block * 8, pixels - 8)
        for channel in range(3):
            at = channel * pixels + first
            value = _encoded(load(straight, at))
            store(encoded, at, value)
            store(image, at, value * load(alpha, first))
            for lane in range(8):
                if saturated[at + lane] and image[at + lane] > limit[first + lane]:
                    image[at + lane], encoded[at + lane] = limit[first + lane], _CLIPPED


@kernel
def encode_backward_range(
    begin, end, pixels, straight, alpha, mask, encoded, g_image, g_normals, mask_weight, normal_weight, scale, g_straight, g_sums
):  # fmt: skip
    """Compute the adjoint of `encode_range`, add the gradients of the other losses, and multiply all by `scale`.

    g_image: (3 P,) gradient of the photometric loss. g_normals: (C P,) that of the normal consistency by the sums of the rasteriser.
    mask_weight: of |alpha - mask| in each pixel. g_straight (3 P,) and g_sums (C P,) receive the gradients of the sum of the losses.
    """
    zero, last = splat(0.0), len(g_sums) - pixels
    for block in range(begin, end):
        first = min(block * 8, pixels - 8)
        a = load(alpha, first)
        difference = a - load(mask, first)
        sign = select(difference > 0.0, splat(mask_weight), select(difference < 0.0, splat(-mask_weight), zero))
        g_alpha = load(g_normals, last + first) * normal_weight + sign
        for channel in range(3):
            at = channel * pixels + first
            linear, value = load(straight, at), load(encoded, at)
            g = select(value < 0.0, zero, load(g_image, at))
            g_alpha = g_alpha + g * value
            line = select(linear < 0.0, zero, splat(_SLOPE))
            slope = select(linear <= _LINEAR, line, (value + _SHIFT) / (linear * _POWER))
            store(g_straight, at, g * a * slope * scale)
        for at in range(first, last, pixels):
            store(g_sums, at, load(g_normals, at) * (normal_weight * scale))
        store(g_sums, last + first, g_alpha * scale)
