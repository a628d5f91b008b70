# SPDX-License-Identifier: GPL-3.0-or-later
"""Images of layers for viewing: (H, W, 4) float in 0..1, sRGB-encoded with straight alpha."""

from __future__ import annotations

import numpy as np

from ..io.quantisation import eight_bits
from ..io.srgb import encode_srgb

# Dark to light in even steps of lightness: black, violet, red, orange, cream.
HEAT = np.array([[0.0, 0.0, 0.02], [0.25, 0.06, 0.42], [0.65, 0.16, 0.35], [0.93, 0.43, 0.13], [0.98, 0.78, 0.30], [1.0, 1.0, 0.85]])

# Less to more around black: light blue, blue, black, orange, cream.
SIGNED = np.array([[0.72, 0.93, 1.0], [0.16, 0.47, 0.86], [0.0, 0.0, 0.02], [0.90, 0.38, 0.10], [1.0, 0.92, 0.70]])
STRIPES = 0.10, 0.30  # grey values of what is not shown


def shaded(rgba: np.ndarray) -> np.ndarray:
    """Convert a linear premultiplied image (H, W, 4) to (H, W, 4), encoded with straight alpha."""
    alpha = np.clip(rgba[..., 3:], 0, 1)
    return with_alpha(encode_srgb(np.clip(rgba[..., :3] / np.maximum(alpha, 1e-6), 0, 1)), alpha[..., 0])


def colour(linear: np.ndarray, alpha: np.ndarray) -> np.ndarray:
    """Show a linear colour layer such as albedo.

    Args:
        linear: (H, W, 3).
        alpha: (H, W).

    Returns:
        Image (H, W, 4).
    """
    return with_alpha(encode_srgb(np.clip(linear, 0, 1)), alpha)


def grey(value: np.ndarray, alpha: np.ndarray) -> np.ndarray:
    """Show a scalar layer such as roughness as grey values, without encoding.

    Args:
        value: (H, W) in 0..1.
        alpha: (H, W).

    Returns:
        Image (H, W, 4).
    """
    return with_alpha(np.repeat(value[..., None], 3, -1), alpha)


def normal(vectors: np.ndarray, alpha: np.ndarray) -> np.ndarray:
    """Show unit vectors as colours: red, green and blue are x, y and z from -1 to 1.

    Args:
        vectors: (H, W, 3).
        alpha: (H, W).

    Returns:
        Image (H, W, 4).
    """
    return with_alpha(0.5 + 0.5 * vectors, alpha)


def heat(error: np.ndarray, limit: float, alpha: np.ndarray | None = None) -> np.ndarray:
    """Show errors as a heat map, from dark (0) to light (`limit` and above).

    Args:
        error: (H, W), not negative.
        limit: error shown in the lightest colour.
        alpha: (H, W); opaque where it is None.

    Returns:
        Image (H, W, 4).
    """
    return with_alpha(_ramp(error / limit, HEAT), np.ones(error.shape) if alpha is None else alpha)


def signed_heat(difference: np.ndarray, limit: float) -> np.ndarray:
    """Show differences by colours: blue where negative, black where 0, orange where positive.

    Args:
        difference: (H, W).
        limit: absolute difference shown in the lightest colours.

    Returns:
        Image (H, W, 4).
    """
    return with_alpha(_ramp(0.5 + 0.5 * difference / limit, SIGNED), np.ones(difference.shape))


def striped(image: np.ndarray, shown: np.ndarray) -> np.ndarray:
    """Draw stripes over a part of an image, 24 to its height.

    Args:
        image: (H, W, 4).
        shown: (H, W) bool, False in that part.

    Returns:
        Image (H, W, 4).
    """
    row, column = np.indices(shown.shape)
    grey_value = np.where((row + column) * 24 // len(shown) % 2, *STRIPES)[..., None]
    return np.where(shown[..., None], image, with_alpha(np.repeat(grey_value, 3, -1), np.ones(shown.shape)))


def _ramp(position: np.ndarray, colours: np.ndarray) -> np.ndarray:
    """Return the colours (H, W, 3) at positions (H, W) in 0..1 along colours (N, 3) at even distances."""
    steps = np.linspace(0, 1, len(colours))
    return np.stack([np.interp(np.clip(position, 0, 1), steps, channel) for channel in colours.T], -1)


def with_alpha(rgb: np.ndarray, alpha: np.ndarray) -> np.ndarray:
    """Join colour and alpha into one image; values that are not finite become 0.

    Args:
        rgb: (H, W, 3), encoded.
        alpha: (H, W).

    Returns:
        Image (H, W, 4) float32 in 0..1.
    """
    return np.nan_to_num(np.clip(np.concatenate([rgb, alpha[..., None]], -1), 0, 1)).astype(np.float32)


def over(image: np.ndarray, backdrop: np.ndarray | float) -> np.ndarray:
    """Blend an image over a backdrop on encoded values, as image viewers do.

    Args:
        image: (H, W, 4).
        backdrop: grey value in 0..1, or (H, W, 3).

    Returns:
        (H, W, 3) uint8.
    """
    rgb = image[..., :3] * image[..., 3:] + backdrop * (1 - image[..., 3:])
    return eight_bits(rgb)
