# SPDX-License-Identifier: GPL-3.0-or-later
"""Colours of an image continued from known pixels into the others."""

from __future__ import annotations

import cv2
import numpy as np

LEAST = 1e-2  # weight of the known pixels in a window from which their mean counts
FINEST = 4.0  # sigma in pixels of a reduced image, at least, with which wide windows are averaged


def continued_colour(colour: np.ndarray, known: np.ndarray, sigma: float, windows: int, wanted: np.ndarray | None = None) -> np.ndarray:
    """Continue colours by means over windows of known pixels, the narrowest that reach.

    Args:
        colour: (H, W, 3).
        known: (H, W) bool, pixels whose colours are kept.
        sigma: of the narrowest window, pixels; each next one is twice as wide.
        windows: number of windows tried; pixels that none of them reaches are 0.
        wanted: (H, W) bool, pixels that matter: no wider window is tried once all of them have a colour. None: all.

    Returns:
        (H, W, 3) float32.
    """
    result, missing = np.where(known[..., None], colour, 0).astype(np.float32), ~known
    source = np.dstack([result, known.astype(np.float32)])
    for _ in range(windows):
        if not (missing if wanted is None else missing & wanted).any():
            break
        mean = _window_means(source, sigma)
        found = missing & (mean[..., 3] > LEAST)
        result[found] = mean[found][:, :3] / mean[found][:, 3:]
        missing &= ~found
        sigma *= 2
    return result


def _window_means(image: np.ndarray, sigma: float) -> np.ndarray:
    """Return the means of an image (H, W, C) over Gaussian windows; wide ones are computed on a reduced image."""
    height, width = image.shape[:2]
    factor = 2 ** max(0, int(np.log2(sigma / FINEST)))
    small = cv2.resize(image, (-(-width // factor), -(-height // factor)), interpolation=cv2.INTER_AREA) if factor > 1 else image
    blurred = cv2.GaussianBlur(small, (0, 0), sigma / factor)
    return cv2.resize(blurred, (width, height), interpolation=cv2.INTER_LINEAR) if factor > 1 else blurred
