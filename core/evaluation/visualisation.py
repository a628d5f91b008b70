# SPDX-License-Identifier: GPL-3.0-or-later
"""Layers as images for people: (H, W, 4) float in 0..1, sRGB-encoded with straight alpha."""

from __future__ import annotations

import numpy as np

from ..io.srgb import encode_srgb

# Dark to light in even steps of lightness: black, violet, red, orange, cream.
HEAT = np.array([[0.0, 0.0, 0.02], [0.25, 0.06, 0.42], [0.65, 0.16, 0.35], [0.93, 0.43, 0.13], [0.98, 0.78, 0.30], [1.0, 1.0, 0.85]])


def shaded(rgba: np.ndarray) -> np.ndarray:
    """Linear premultiplied (H, W, 4) as an image."""
    alpha = np.clip(rgba[..., 3:], 0, 1)
    return with_alpha(encode_srgb(np.clip(rgba[..., :3] / np.maximum(alpha, 1e-6), 0, 1)), alpha[..., 0])


def colour(linear: np.ndarray, alpha: np.ndarray) -> np.ndarray:
    """A linear colour layer (H, W, 3) such as albedo, with alpha (H, W)."""
    return with_alpha(encode_srgb(np.clip(linear, 0, 1)), alpha)


def grey(value: np.ndarray, alpha: np.ndarray) -> np.ndarray:
    """A number layer (H, W) in 0..1 shown as it is, such as roughness."""
    return with_alpha(np.repeat(value[..., None], 3, -1), alpha)


def normal(vectors: np.ndarray, alpha: np.ndarray) -> np.ndarray:
    """Unit vectors (H, W, 3): red, green, blue are x, y, z from -1 to 1."""
    return with_alpha(0.5 + 0.5 * vectors, alpha)


def heat(error: np.ndarray, limit: float, alpha: np.ndarray | None = None) -> np.ndarray:
    """Errors (H, W) from 0 (dark) to `limit` and above (light)."""
    place = np.clip(error / limit, 0, 1)
    channels = [np.interp(place, np.linspace(0, 1, len(HEAT)), HEAT[:, i]) for i in range(3)]
    return with_alpha(np.stack(channels, -1), np.ones(error.shape) if alpha is None else alpha)


def with_alpha(rgb: np.ndarray, alpha: np.ndarray) -> np.ndarray:
    """Encoded (H, W, 3) and alpha (H, W) in one image, what is not finite shown as 0."""
    return np.nan_to_num(np.clip(np.concatenate([rgb, alpha[..., None]], -1), 0, 1)).astype(np.float32)


def over(image: np.ndarray, backdrop: np.ndarray | float) -> np.ndarray:
    """(H, W, 3) uint8: the image on a backdrop, a grey value or (H, W, 3), blended as viewers do (on encoded values)."""
    rgb = image[..., :3] * image[..., 3:] + backdrop * (1 - image[..., 3:])
    return np.round(255 * np.clip(rgb, 0, 1)).astype(np.uint8)
