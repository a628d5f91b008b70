# SPDX-License-Identifier: GPL-3.0-or-later
"""Masks whose edge is moved outwards or inwards."""

from __future__ import annotations

import cv2
import numpy as np


def grown_mask(mask: np.ndarray, pixels: float) -> np.ndarray:
    """Widen or narrow a mask by a disc: the maximum or the minimum over the pixels within a radius.

    Args:
        mask: (H, W) uint8 or float32.
        pixels: radius, rounded; the mask is widened where it is > 0, and narrowed where it is < 0.

    Returns:
        (H, W) of the same type; the mask itself where the rounded radius is 0.
    """
    reach = round(float(pixels))
    if reach == 0:
        return mask
    disc = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * abs(reach) + 1, 2 * abs(reach) + 1))
    return (cv2.dilate if reach > 0 else cv2.erode)(mask, disc)
