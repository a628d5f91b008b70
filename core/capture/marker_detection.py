# SPDX-License-Identifier: GPL-3.0-or-later
"""Detection of square fiducial markers (ArUco, AprilTag) of any common dictionary in one image."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

import cv2
import numpy as np

from .marker_corners import refine_corners

# Dictionaries of each number of cells along a side; ArUco's smaller ones are the beginnings of those of 1000.
DICTIONARIES = {
    4: ("DICT_4X4_1000", "DICT_APRILTAG_16H5"),
    5: ("DICT_5X5_1000", "DICT_ARUCO_ORIGINAL", "DICT_APRILTAG_25H9"),
    6: ("DICT_6X6_1000", "DICT_APRILTAG_36H11", "DICT_APRILTAG_36H10", "DICT_ARUCO_MIP_36H12"),
    7: ("DICT_7X7_1000",),
}
CELL_PIXELS = 8  # pixels of a cell in the rectified marker
MAX_CORRECTED_FRACTION = 0.3  # fraction of the correctable bits that may be wrong: more would find markers in any texture
MAX_BORDER_ERRORS = 0.1  # largest fraction of white cells in the black border
MIN_SPREAD = 20.0  # grey levels between black and white cells


@dataclass(frozen=True, eq=False)
class Detection:
    """Marker in an image.

    Attributes:
        dictionary: name of its dictionary in OpenCV.
        number: its id.
        corners: (4, 2) float64 pixels in OpenCV's corner order; the first pixel's centre is at (0.5, 0.5).
    """

    dictionary: str
    number: int
    corners: np.ndarray


def detect_markers(grey: np.ndarray) -> list[Detection]:
    """Find the markers in an image.

    Args:
        grey: (H, W) uint8.
    """
    found = []
    for corners in _quadrilaterals(grey):
        for cells, names in DICTIONARIES.items():
            bits = _read_cells(grey, corners, cells)
            if bits is None:
                continue
            for name in names:
                known, number, turns = _dictionary(name).identify(bits, MAX_CORRECTED_FRACTION)
                refined = refine_corners(grey, corners) if known else None
                if refined is not None:
                    found.append(Detection(name, int(number), np.roll(refined, turns, axis=0) + 0.5))
    return found


@cache
def _dictionary(name: str) -> cv2.aruco.Dictionary:
    return cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, name))


@cache
def _detector() -> cv2.aruco.ArucoDetector:
    return cv2.aruco.ArucoDetector(_dictionary("DICT_4X4_50"), cv2.aruco.DetectorParameters())


def _quadrilaterals(grey: np.ndarray) -> list[np.ndarray]:
    """Return dark quadrilaterals (4, 2) float32, clockwise in the image; OpenCV's detector finds them before it reads any."""
    known, _, others = _detector().detectMarkers(grey)
    quadrilaterals = [np.asarray(one, np.float32).reshape(4, 2) for one in (*known, *others)]
    return [one for one in quadrilaterals if min(np.linalg.norm(one - np.roll(one, 1, 0), axis=1)) >= 8]


def _read_cells(grey: np.ndarray, corners: np.ndarray, cells: int) -> np.ndarray | None:
    """Read the cells (N, N) uint8 inside the border, 1 for white; None if there is no black border or no contrast."""
    side = (cells + 2) * CELL_PIXELS
    square = np.array([[0, 0], [side, 0], [side, side], [0, side]], np.float32) - 0.5
    flat = cv2.warpPerspective(grey, cv2.getPerspectiveTransform(corners, square), (side, side))
    inner = flat.reshape(cells + 2, CELL_PIXELS, cells + 2, CELL_PIXELS)[:, 2:-2, :, 2:-2].mean((1, 3))
    threshold, _ = cv2.threshold(flat, 0, 255, cv2.THRESH_BINARY + cv2.THRESH_OTSU)
    white = inner > threshold
    border = np.ones_like(white)
    border[1:-1, 1:-1] = False
    if not white.any() or white[border].mean() > MAX_BORDER_ERRORS or inner[white].mean() - inner[~white].mean() < MIN_SPREAD:
        return None
    return white[1:-1, 1:-1].astype(np.uint8)
