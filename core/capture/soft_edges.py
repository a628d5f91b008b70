# SPDX-License-Identifier: GPL-3.0-or-later
"""Soft edges of masks: coverage of the pixels at the silhouette, by a guided filter."""

from __future__ import annotations

import cv2
import numpy as np

RADIUS = 2  # pixels of the filter's window beside its centre
EPSILON = 1e-3  # variance of the guide below which the window counts as flat
BAND = 1.5  # pixels on either side of the edge that may be neither 0 nor 1


def guided_filter(guide: np.ndarray, image: np.ndarray, radius: int, epsilon: float) -> np.ndarray:
    """Filter an image so that its edges follow those of a guide (He, Sun and Tang 2013).

    Args:
        guide: (H, W) float32.
        image: (H, W) float32.
        radius: pixels of the window beside its centre.
        epsilon: variance of the guide below which the result is an average.

    Returns:
        The filtered image (H, W) float32.
    """
    mean = lambda a: cv2.boxFilter(a, -1, (2 * radius + 1, 2 * radius + 1), borderType=cv2.BORDER_REFLECT)  # noqa: E731
    of_guide, of_image = mean(guide), mean(image)
    slope = (mean(guide * image) - of_guide * of_image) / (mean(guide * guide) - of_guide**2 + epsilon)
    return mean(slope) * guide + mean(of_image - slope * of_guide)


def soft_edges(colour: np.ndarray, mask: np.ndarray) -> np.ndarray:
    """Return a mask whose pixels at the edge hold their coverage.

    Args:
        colour: (H, W, 3) float32 sRGB photograph.
        mask: (H, W) float32, nearly binary.

    Returns:
        (H, W) float32 in 0..1, 0 or 1 farther than BAND pixels from the edge.
    """
    inside = (mask >= 0.5).astype(np.uint8)
    guide = cv2.cvtColor(np.clip(colour, 0, 1).astype(np.float32), cv2.COLOR_RGB2GRAY)
    # The average of the binary mask over a pixel's surroundings is its coverage by a straight edge; the guide puts the edge right.
    filtered = guided_filter(guide, cv2.GaussianBlur(inside.astype(np.float32), (0, 0), 0.6), RADIUS, EPSILON)
    depth, beside = (cv2.distanceTransform(part, cv2.DIST_L2, 3) for part in (inside, 1 - inside))
    alpha = np.clip(filtered, 0, 1)
    return np.where(depth > BAND, 1, np.where(beside > BAND, 0, alpha)).astype(np.float32)
