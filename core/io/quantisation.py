# SPDX-License-Identifier: GPL-3.0-or-later
"""Quantisation of images to 8 bits, or to 16."""

from __future__ import annotations

import numpy as np

from .srgb import encode_srgb


def eight_bits(values: np.ndarray) -> np.ndarray:
    """Convert values 0..1 (...,) to uint8, rounded to the nearest; values outside are clipped, and NaN becomes 0."""
    return np.round(255 * np.nan_to_num(np.clip(values, 0, 1))).astype(np.uint8)


def sixteen_bits(values: np.ndarray) -> np.ndarray:
    """Convert values 0..1 (...,) to uint16, as `eight_bits` does to uint8."""
    return np.round(65535 * np.nan_to_num(np.clip(values, 0, 1))).astype(np.uint16)


def quantised(values: np.ndarray, bits: int) -> np.ndarray:
    """Convert values 0..1 (...,) to integers of 8 or 16 bits: uint8 or uint16.

    Args:
        values: values outside of 0..1 are clipped, and NaN becomes 0.
        bits: 8 or 16.
    """
    return eight_bits(values) if bits == 8 else sixteen_bits(values)


def srgb_quantised(linear: np.ndarray, bits: int) -> np.ndarray:
    """Encode linear values 0..1 (...,) by the sRGB curve, and convert them to integers of 8 or 16 bits; values outside are clipped."""
    return quantised(encode_srgb(np.clip(linear, 0, 1)), bits)


def srgb_eight_bits(linear: np.ndarray) -> np.ndarray:
    """Encode linear values 0..1 (...,) by the sRGB curve, and convert them to uint8; values outside are clipped."""
    return srgb_quantised(linear, 8)


def bits_of(pixels: np.ndarray) -> int:
    """Return the bits of each value of an image of uint8 or uint16: 8 or 16."""
    return 8 * pixels.dtype.itemsize


def in_eight_bits(pixels: np.ndarray) -> np.ndarray:
    """Return an image (...,) uint8 or uint16 with 8 bits for each value, rounded to the nearest; one of 8 bits is returned itself."""
    if bits_of(pixels) == 8:
        return pixels
    return ((pixels.astype(np.uint32) + 128) // 257).astype(np.uint8)  # 65535 = 257 * 255
