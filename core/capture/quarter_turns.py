# SPDX-License-Identifier: GPL-3.0-or-later
"""Quarter turns between an image as its sensor stored it and its upright copy: pixels, intrinsics and poses.

All photographs of one lens share their intrinsics in stored pixels, however the camera was held.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ..datasets.parsed_dataset import Lens
from .photograph import Photograph


def stored_size(photograph: Photograph) -> tuple[int, int]:
    """Return (width, height) in pixels as the sensor stored the photograph."""
    return (photograph.height, photograph.width) if photograph.turned % 2 else (photograph.width, photograph.height)


def turn_pixels(pixels: np.ndarray, width: int, height: int, turns: int) -> np.ndarray:
    """Move places in an image to where they are after quarter turns anticlockwise.

    Args:
        pixels: (N, 2) places (x, y); the first pixel's centre is at (0.5, 0.5).
        width: width of the image before the turns, pixels.
        height: height of the image before the turns, pixels.
        turns: number of quarter turns anticlockwise.

    Returns:
        Places (N, 2) in the turned image.
    """
    for _ in range(turns % 4):
        pixels = np.stack([pixels[:, 1], width - pixels[:, 0]], -1)
        width, height = height, width
    return pixels


def turn_lens(lens: Lens, turns: int) -> Lens:
    """Return the intrinsics of the image after quarter turns anticlockwise.

    With X = y and Y = -x in normalised coordinates, the tangential coefficients become p1' = -p2 and p2' = p1.

    Args:
        lens: lens of the image before the turns, not a fisheye.
        turns: number of quarter turns anticlockwise.
    """
    for _ in range(turns % 4):
        k1, k2, p1, p2, *rest = lens.distortion or (0.0,) * 5
        lens = replace(
            lens,
            width=lens.height,
            height=lens.width,
            fx=lens.fy,
            fy=lens.fx,
            cx=lens.cy,
            cy=lens.width - lens.cx,
            distortion=(k1, k2, -p2, p1, *rest) if lens.distortion else (),
        )
    return lens


def camera_turn(turns: int) -> np.ndarray:
    """Return the rotation (3, 3) from the camera of an image to that of the image after quarter turns anticlockwise, OpenCV's axes."""
    quarter = np.array([[0.0, 1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    return np.linalg.matrix_power(quarter, turns % 4)
