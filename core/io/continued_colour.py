# SPDX-License-Identifier: GPL-3.0-or-later
"""Colours of an image continued from known pixels into the others."""

from __future__ import annotations

import cv2
import numpy as np

LEAST = 1e-2  # weight of the known pixels in a window from which their mean counts


def continued_colour(colour: np.ndarray, known: np.ndarray, sigma: float, windows: int) -> np.ndarray:
    """Continue colours by means over windows of known pixels, the narrowest that reach.

    Args:
        colour: (H, W, 3).
        known: (H, W) bool, pixels whose colours are kept.
        sigma: of the narrowest window, pixels; each next one is twice as wide.
        windows: number of windows tried; pixels that none of them reaches are 0.

    Returns:
        (H, W, 3) float32.
    """
    result, missing = np.where(known[..., None], colour, 0).astype(np.float32), ~known
    source, weight = result.copy(), known.astype(np.float32)
    for _ in range(windows):
        if not missing.any():
            break
        near = cv2.GaussianBlur(weight, (0, 0), sigma)
        found = missing & (near > LEAST)
        result[found] = cv2.GaussianBlur(source, (0, 0), sigma)[found] / near[found, None]
        missing &= ~found
        sigma *= 2
    return result
