# SPDX-License-Identifier: GPL-3.0-or-later
"""Confidence of the recovered light in each direction: low where it varies strongly, or where the photographs do not constrain it.

The photographs show the light blurred, so that the place of an edge and the brightness of a lamp are known worse than an even sky.
"""

from __future__ import annotations

import math

import numpy as np
from scipy.ndimage import gaussian_filter1d

from ..io.srgb import encode_srgb

BLUR = math.radians(3)  # standard deviation of the Gaussian window, radians; 2 to 5 degrees tell errors about as well on five scenes
HALF_CONTRAST = 0.1  # standard deviation of encoded values in the window at which the confidence is halved
# Largest confidence where the photographs do not constrain the light. Its smooth guess errs less there than the map does at its edges.
MAX_UNCONSTRAINED = 0.5


def light_confidence(light: np.ndarray, part: np.ndarray) -> np.ndarray:
    """Return the confidence in 0..1 of each direction of a light.

    Args:
        light: lat-long map (H, 2H, 3), linear; values above 1 count as 1, as in the metrics of the light.
        part: (H, 2H) bool, directions that the photographs constrain.

    Returns:
        (H, 2H) float64.
    """
    values = encode_srgb(np.clip(light, 0, 1)).mean(-1)
    variance = _blurred(values**2) - _blurred(values) ** 2
    contrast = np.sqrt(np.maximum(variance, 0))
    return np.minimum(1 / (1 + contrast / HALF_CONTRAST), np.where(part, 1.0, MAX_UNCONSTRAINED))


def _blurred(values: np.ndarray) -> np.ndarray:
    """Blur a lat-long map (H, W) by a window of BLUR on the sphere."""
    height = len(values)
    sigma = BLUR * height / math.pi
    sine = np.sin((np.arange(height) + 0.5) * math.pi / height)
    widths = np.minimum(sigma / sine, height / 2)  # near the poles the window holds most of a row
    rows = [gaussian_filter1d(row, width, mode="wrap") for row, width in zip(values, widths, strict=True)]
    return gaussian_filter1d(np.stack(rows), sigma, axis=0, mode="nearest")
