# SPDX-License-Identifier: GPL-3.0-or-later
"""Sharpness of a photograph: the width of its blur, from the loss of gradient energy when it is blurred further."""

from __future__ import annotations

import cv2
import numpy as np

from .photographs import LoadedPhotograph

FURTHER_BLUR = 2.0  # standard deviation of the further blur, pixels
SHARP_BLUR = 0.8  # blur of a sharp photograph, pixels; less does not count as sharper
WEAK_FRACTION = 0.5  # fraction of the pixels, those with the weakest gradients, that are left out as noise
MAX_BLUR = 16.0  # blur, pixels, beyond which nothing is measured


def relative_blur(photograph: LoadedPhotograph) -> float:
    """Return the width of a photograph's blur as a multiple of SHARP_BLUR, >= 1.

    An edge with a blur of standard deviation s has gradient energy in proportion to 1 / s, so that a further blur t divides the energy by
    q = sqrt(1 + t^2 / s^2).

    Args:
        photograph: decoded; only the part inside its mask is measured.
    """
    grey = photograph.linear[photograph.pyramid[0][..., 1]]
    encoded = np.sqrt(np.clip(grey, 0, None))
    before, after = (_energy(image) for image in (encoded, cv2.GaussianBlur(encoded, (0, 0), FURTHER_BLUR)))
    if photograph.alpha is not None and not photograph.lens.distorted:
        mask = cv2.resize(photograph.alpha, before.shape[::-1], interpolation=cv2.INTER_LINEAR) > 0.99
        mask = cv2.erode(mask.astype(np.uint8), np.ones((9, 9))) > 0
        before, after = before[mask], after[mask]
    before, after = before.ravel(), after.ravel()
    if len(before) < 100:
        return 1.0
    strong = before >= np.quantile(before, WEAK_FRACTION)
    ratio = float(before[strong].sum() / max(float(after[strong].sum()), 1e-30))
    width = FURTHER_BLUR / np.sqrt(max(ratio**2 - 1, (FURTHER_BLUR / MAX_BLUR) ** 2))
    return max(1.0, width / SHARP_BLUR)


def _energy(image: np.ndarray) -> np.ndarray:
    """Return the squared gradient (H, W) of an image."""
    return cv2.Sobel(image, cv2.CV_32F, 1, 0) ** 2 + cv2.Sobel(image, cv2.CV_32F, 0, 1) ** 2
