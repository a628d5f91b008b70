# SPDX-License-Identifier: GPL-3.0-or-later
"""Masks that people give with their photographs, turned and resized to the upright copies."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np

from ..errors import InputError
from ..io.atomic import write_atomic
from .decoding import decode_photograph
from .exif import Orientation

MAX_ASPECT_DIFFERENCE = 0.02  # relative difference of aspect ratios up to which a mask fits a photograph


def write_given_mask(file: Path, size: tuple[int, int], orientation: Orientation, target: Path) -> None:
    """Write a mask file as 8-bit PNG of an upright copy's size.

    A mask with the shape of the stored pixels is turned as the photograph was; one with the shape of the upright copy, or with an
    orientation of its own, is upright already.

    Args:
        file: the mask; its alpha where it has one, else its largest channel, 255 (or 1 where no value is larger) on the object.
        size: (width, height) of the upright copy in pixels.
        orientation: orientation of the photograph.
        target: the PNG to write.

    Raises:
        InputError: if the mask can't be read, or has another aspect ratio than the photograph.
    """
    decoded = decode_photograph(file)
    mask = _eight_bit(decoded.colour.max(-1) if decoded.alpha is None else decoded.alpha)
    width, height = size
    stored = (height, width) if orientation.turned % 2 else size
    if decoded.shot.orientation == Orientation() and _fits(mask, stored):
        mask = orientation.upright(mask)
    if not _fits(mask, size):
        raise InputError(
            file, f"has {mask.shape[1]}x{mask.shape[0]} pixels, its photograph {size[0]}x{size[1]}", "make it anew from the photograph"
        )
    write_mask(target, _resized(mask, size))


def write_mask(target: Path, mask: np.ndarray) -> None:
    """Write a mask (H, W) uint8 or uint16 as 8-bit PNG atomically.

    Args:
        target: the file.
        mask: largest value on the object.
    """
    write_atomic(target, cv2.imencode(".png", _scaled(mask))[1].tobytes())


def _eight_bit(mask: np.ndarray) -> np.ndarray:
    """Return a mask in 0..255; labels 0 and 1 are stretched to that."""
    mask = _scaled(mask)
    return mask * 255 if mask.max() == 1 else mask


def _scaled(mask: np.ndarray) -> np.ndarray:
    """Return a mask of 8 or 16 bits with 8."""
    return (mask // 257).astype(np.uint8) if mask.dtype == np.uint16 else mask


def _fits(mask: np.ndarray, size: tuple[int, int]) -> bool:
    """Return True for a mask of an image's aspect ratio."""
    return abs(mask.shape[1] * size[1] / (mask.shape[0] * size[0]) - 1) < MAX_ASPECT_DIFFERENCE


def _resized(mask: np.ndarray, size: tuple[int, int]) -> np.ndarray:
    """Resize a mask by area averaging, or linearly where it grows."""
    if mask.shape[::-1] == size:
        return mask
    return cv2.resize(mask, size, interpolation=cv2.INTER_AREA if mask.shape[1] > size[0] else cv2.INTER_LINEAR)
