# SPDX-License-Identifier: GPL-3.0-or-later
"""Images of a real camera: the scene's own, seen through a lens with distortion and a shifted centre."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from .source import Source

STEPS = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 100, 1e-9)


@dataclass(frozen=True)
class RealLens:
    """Lens with distortion.

    Attributes:
        focal: focal length in pixels.
        cx: column of the principal point in pixels.
        cy: row of the principal point in pixels.
        distortion: OpenCV's coefficients k1, k2, p1, p2, k3.
    """

    focal: float
    cx: float
    cy: float
    distortion: tuple[float, float, float, float, float]

    @classmethod
    def of(cls, source: Source) -> RealLens:
        """Return a lens like a smartphone's for images of the scene's size."""
        width, height = source.size
        return cls(source.focal * 0.97, 0.5 * width + 0.02 * width, 0.5 * height - 0.03 * height, (0.06, -0.02, 0.004, -0.003, 0.0))

    def image(self, source: Source, rgba: np.ndarray) -> np.ndarray:
        """Return an image as seen through the lens.

        Args:
            source: scene of the image.
            rgba: (H, W, 4) uint8.

        Returns:
            (H, W, 4) uint8.
        """
        width, height = source.size
        x, y = np.meshgrid(np.arange(width, dtype=np.float64), np.arange(height, dtype=np.float64))
        pixels = np.stack([x, y], -1).reshape(-1, 1, 2)
        ideal = matrix(source.focal, width / 2, height / 2)
        own = matrix(self.focal, self.cx, self.cy)
        seen = cv2.undistortPointsIter(pixels, own, np.array(self.distortion), np.eye(3), ideal, STEPS).reshape(height, width, 2)
        alpha = rgba[..., 3:].astype(np.float32) / 255
        whole = np.concatenate([rgba[..., :3] * alpha, 255 * alpha], -1).astype(np.float32)
        moved = cv2.remap(
            whole, seen[..., 0].astype(np.float32), seen[..., 1].astype(np.float32), cv2.INTER_LINEAR, borderMode=cv2.BORDER_CONSTANT
        )
        colour = moved[..., :3] / np.maximum(moved[..., 3:] / 255, 1e-6)
        return np.round(np.clip(np.concatenate([colour, moved[..., 3:]], -1), 0, 255)).astype(np.uint8)


def matrix(focal: float, cx: float, cy: float) -> np.ndarray:
    """Return the camera matrix (3, 3) in OpenCV's coordinates, where pixel centres are integers.

    Args:
        focal: focal length in pixels.
        cx: column of the principal point in pixels.
        cy: row of the principal point in pixels.
    """
    return np.array([[focal, 0, cx - 0.5], [0, focal, cy - 0.5], [0, 0, 1]])
