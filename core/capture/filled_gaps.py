# SPDX-License-Identifier: GPL-3.0-or-later
"""Gaps that masks fill, such as between an arm and the body: pixels deep inside whose colours are the background's.

One photograph is no proof, as a glossy object mirrors its surroundings. But a gap is empty in space, and several photographs look through
it. So the pixels whose colours are the object's are carved into a hull, as masks are, and gaps are where its silhouettes are open.
"""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np

from ..scene.camera import Camera
from ..scene.dataset import Bound
from .soft_hull import silhouettes, soft_hull
from .support_plane import SupportPlane

BLUR = 0.8  # errors of a mask, sigma of the blur of the colours' evidence
EMPTY_SILHOUETTE = 0.5  # how surely other views see the object, below which a pixel is a gap whatever its own colour
DOUBTED_SILHOUETTE = 0.98  # the same, below which its own colour may say so
MIN_EVIDENCE = 1.0  # log-likelihood ratio of background to object from which it does
MARGIN = 1  # pixels by which gaps are widened


def blurred(evidence: np.ndarray, error: float) -> np.ndarray:
    """Return log-likelihood ratios (H, W) without the noise of single pixels; error: of the mask's edge, pixels."""
    return cv2.GaussianBlur(evidence, (0, 0), max(BLUR * error, 0.5))


def carved_silhouettes(
    cameras: Sequence[Camera], masks: Sequence[np.ndarray], bound: Bound, plane: SupportPlane
) -> list[np.ndarray] | None:
    """Return how surely other views see the object at the pixels of each view, (H, W) float32 0..1; None where they contradict each other.

    Args:
        cameras: cameras of the views.
        masks: (H, W) bool of each view, where its mask and its colours say that it shows the object.
        bound: sphere about the object.
        plane: plane that the object stands on.
    """
    hull = soft_hull(cameras, [mask.astype(np.float32) for mask in masks], np.ones(len(cameras)), bound, plane)
    return None if hull is None else silhouettes(hull, cameras)


def gaps_in(inside: np.ndarray, evidence: np.ndarray, silhouette: np.ndarray) -> np.ndarray:
    """Return the pixels (H, W) bool of a mask's inside that are gaps, or at the edge of one.

    Args:
        inside: (H, W) bool, pixels far inside the mask.
        evidence: (H, W) log-likelihood ratio of background to object, from `blurred`.
        silhouette: (H, W) 0..1, from `carved_silhouettes`.
    """
    own = (evidence > MIN_EVIDENCE) & (silhouette < DOUBTED_SILHOUETTE)
    found = inside & (own | (silhouette < EMPTY_SILHOUETTE))
    side = 2 * MARGIN + 1
    return cv2.dilate(found.astype(np.uint8), np.ones((side, side), np.uint8)) > 0
