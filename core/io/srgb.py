# SPDX-License-Identifier: GPL-3.0-or-later
"""The sRGB curve, once for numpy and torch."""

from __future__ import annotations

import sys
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np

if TYPE_CHECKING:
    import torch

Array = TypeVar("Array", np.ndarray, "torch.Tensor")


def _library(array: Any) -> Any:
    """numpy or torch. Whoever has a tensor has loaded torch, which takes longer than reading a dataset does without."""
    torch = sys.modules.get("torch")
    return torch if torch is not None and isinstance(array, torch.Tensor) else np


def encode_srgb(linear: Array) -> Array:
    """Linear Rec.709 (>= 0, negative counts as 0) to sRGB-encoded, any shape; above 1 the curve goes on (IEC 61966-2-1)."""
    xp = _library(linear)
    # The clip inside the power keeps its slope finite where the linear toe is chosen.
    power = 1.055 * xp.clip(linear, 0.0031308, None) ** (1 / 2.4) - 0.055
    return xp.where(linear <= 0.0031308, 12.92 * xp.clip(linear, 0.0, None), power)


def decode_srgb(encoded: Array) -> Array:
    """sRGB-encoded (>= 0) to linear Rec.709, any shape; inverse of `encode_srgb`."""
    xp = _library(encoded)
    power = ((xp.clip(encoded, 0.04045, None) + 0.055) / 1.055) ** 2.4
    return xp.where(encoded <= 0.04045, encoded / 12.92, power)


def luminance(linear: Array) -> Array:
    """(..., 3) linear Rec.709 to (...) luminance."""
    channels: Any = linear  # numpy's and torch's operators have no common type
    return 0.2126 * channels[..., 0] + 0.7152 * channels[..., 1] + 0.0722 * channels[..., 2]
