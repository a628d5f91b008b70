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


def srgb_eight_bits(linear: np.ndarray) -> np.ndarray:
    """Encode linear values 0..1 (...,) by the sRGB curve, and convert them to uint8; values outside are clipped."""
    return eight_bits(encode_srgb(np.clip(linear, 0, 1)))
