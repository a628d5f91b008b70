# SPDX-License-Identifier: GPL-3.0-or-later
"""sRGB transfer curve and luminance, for numpy arrays and torch tensors."""

from __future__ import annotations

import sys
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np

if TYPE_CHECKING:
    import torch

Array = TypeVar("Array", np.ndarray, "torch.Tensor")


def _library(array: Any) -> Any:
    """Return numpy or torch; torch is not imported for it, since that takes longer than reading a dataset."""
    torch = sys.modules.get("torch")
    return torch if torch is not None and isinstance(array, torch.Tensor) else np


def encode_srgb(linear: Array) -> Array:
    """Encode linear Rec.709 values (...,) of any shape by the sRGB curve (IEC 61966-2-1).

    Args:
        linear: (...,) values; negative ones count as 0, and the curve is extended above 1.
    """
    xp = _library(linear)
    # The clip inside the power keeps its gradient finite where the linear segment is selected.
    power = 1.055 * xp.clip(linear, 0.0031308, None) ** (1 / 2.4) - 0.055
    return xp.where(linear <= 0.0031308, 12.92 * xp.clip(linear, 0.0, None), power)


def straight_srgb(rgba: np.ndarray) -> np.ndarray:
    """Encode an image (H, W, 4), linear premultiplied, as sRGB with straight alpha, (H, W, 4) in 0..1; transparent pixels are black."""
    alpha = np.clip(rgba[..., 3:], 0, 1)
    straight = np.divide(rgba[..., :3], alpha, out=np.zeros_like(rgba[..., :3]), where=alpha > 1e-6)
    return np.concatenate([np.clip(encode_srgb(straight), 0, 1), alpha], -1)


def decode_srgb(encoded: Array) -> Array:
    """Decode sRGB-encoded values (...,) >= 0 of any shape to linear Rec.709; inverse of `encode_srgb`."""
    xp = _library(encoded)
    power = ((xp.clip(encoded, 0.04045, None) + 0.055) / 1.055) ** 2.4
    return xp.where(encoded <= 0.04045, encoded / 12.92, power)


def luminance(linear: Array) -> Array:
    """Return the luminance (...,) of linear Rec.709 colours (..., 3)."""
    channels: Any = linear  # numpy's and torch's operators have no common type
    return 0.2126 * channels[..., 0] + 0.7152 * channels[..., 1] + 0.0722 * channels[..., 2]
