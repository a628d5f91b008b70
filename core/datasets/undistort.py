# SPDX-License-Identifier: GPL-3.0-or-later
"""Undistortion: images of a real lens, resampled as a pinhole camera sees them."""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache

import cv2
import numpy as np

from ..errors import InputError
from ..io.image import DecodedImage
from .parsed_dataset import Lens

GRID = 33  # samples along a side of the check for blank borders
LARGEST_ZOOM = 3.0  # beyond, almost nothing of the image would be left


@lru_cache(maxsize=256)
def pinhole(lens: Lens) -> Lens:
    """Return the pinhole lens of the undistorted image, with the same size and principal point.

    The focal lengths are raised just enough for every pixel to have a source, so that no blank corner is taken for background.

    Raises:
        InputError: if the coefficients are impossible for images of this size.
    """
    plain = replace(lens, distortion=(), fisheye=False)
    if not lens.distorted:
        return plain
    if _covered(lens, 1.0):
        return plain
    low, high = 1.0, 1.05
    while not _covered(lens, high):
        low, high = high, high * 1.05
        if high > LARGEST_ZOOM:
            raise InputError("lens distortion", f"can't be removed ({lens})", "check the distortion coefficients")
    for _ in range(20):
        middle = (low + high) / 2
        low, high = (low, middle) if _covered(lens, middle) else (middle, high)
    return replace(plain, fx=lens.fx * high, fy=lens.fy * high)


def undistort(image: DecodedImage, lens: Lens) -> DecodedImage:
    """Resample an image as `pinhole(lens)` sees it: bicubic, with colour weighted by alpha.

    Args:
        image: float image.
        lens: the lens that it was taken with, of the image's size.
    """
    if not lens.distorted:
        return image
    maps = _maps(lens)
    brightest = max(1.0, float(image.colour.max()))  # bicubic overshoots
    if image.alpha is None:
        return DecodedImage(np.clip(_resample(image.colour, maps), 0, brightest), None)
    pixels = _resample(np.dstack([image.colour * image.alpha[..., None], image.alpha]), maps)
    alpha = pixels[..., 3]
    # Premultiplied colour and alpha overshoot alike, so that their quotient is still the colour.
    straight = np.where(alpha[..., None] > 1e-3, pixels[..., :3] / np.maximum(alpha, 1e-3)[..., None], 0)
    return DecodedImage(np.clip(straight, 0, brightest), np.clip(alpha, 0, 1))


def undistort_mask(mask: np.ndarray, lens: Lens) -> np.ndarray:
    """Resample a mask as `pinhole(lens)` sees it.

    Args:
        mask: (H, W) float32 in 0..1.
        lens: the lens that its image was taken with, of the mask's size.
    """
    return np.clip(_resample(mask, _maps(lens)), 0, 1) if lens.distorted else mask


def source_positions(lens: Lens, output: Lens) -> tuple[np.ndarray, np.ndarray]:
    """Return where the image of a lens shows what a pinhole camera of the same pose sees.

    Args:
        lens: of the image.
        output: pinhole, which may have another size, focal length and principal point.

    Returns:
        x and y (H, W) float32 in the image of `lens` for each pixel of `output`; OpenCV's pixel centres are at integers.
    """
    build = cv2.fisheye.initUndistortRectifyMap if lens.fisheye else cv2.initUndistortRectifyMap
    coefficients = np.array(lens.distortion or (0.0,) * 4, np.float64)
    return build(_matrix(lens), coefficients, np.eye(3), _matrix(output), output.size, cv2.CV_32FC1)


def _resample(pixels: np.ndarray, maps: tuple[np.ndarray, np.ndarray]) -> np.ndarray:
    return cv2.remap(pixels, *maps, cv2.INTER_CUBIC, borderMode=cv2.BORDER_REPLICATE)


@lru_cache(maxsize=8)
def _maps(lens: Lens) -> tuple[np.ndarray, np.ndarray]:
    return source_positions(lens, pinhole(lens))


def _covered(lens: Lens, zoom: float) -> bool:
    """Return True if every output pixel at this zoom has a source inside the image, and the mapping does not fold over."""
    plain = replace(lens, fx=lens.fx * zoom, fy=lens.fy * zoom, distortion=(), fisheye=False)
    # A coarse image whose outermost pixel centres are those of the real one.
    x = _stretch(lens.width, plain.fx, plain.cx)
    y = _stretch(lens.height, plain.fy, plain.cy)
    coarse = replace(plain, width=GRID, height=GRID, fx=x[0], cx=x[1], fy=y[0], cy=y[1])
    u, v = source_positions(lens, coarse)
    inside = (u.min() >= -0.5) and (v.min() >= -0.5) and (u.max() <= lens.width - 0.5) and (v.max() <= lens.height - 0.5)
    return bool(inside and (np.diff(u, axis=1) > 0).all() and (np.diff(v, axis=0) > 0).all())


def _stretch(pixels: int, focal: float, centre: float) -> tuple[float, float]:
    scale = (GRID - 1) / max(pixels - 1, 1)
    return focal * scale, (centre - 0.5) * scale + 0.5


def _matrix(lens: Lens) -> np.ndarray:
    return np.array([[lens.fx, 0, lens.cx - 0.5], [0, lens.fy, lens.cy - 0.5], [0, 0, 1]], np.float64)
