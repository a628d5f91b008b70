# SPDX-License-Identifier: GPL-3.0-or-later
"""Embedded ICC profiles: conversion of photographs to sRGB."""

from __future__ import annotations

import functools
import io
from typing import Any

import numpy as np
from PIL import Image, ImageCms

MODES = {"RGB": "RGB", "CMYK": "CMYK", "GRAY": "L"}  # Pillow's mode by the profile's colour space
SAME = 2  # levels of 255 by which colours of an sRGB profile may differ from sRGB
STEPS = 6  # colours of a grid in each channel on which profiles are compared


class UnusableProfileError(Exception):
    """Profile that is damaged or belongs to other pixels."""


def to_srgb(image: Image.Image, profile: bytes) -> Image.Image | None:
    """Convert an image to sRGB by its embedded profile.

    Args:
        image: image of mode RGB, L or CMYK.
        profile: the ICC profile.

    Returns:
        The image in RGB; None where the profile is sRGB already.

    Raises:
        UnusableProfileError: if the profile is damaged or not one of the image's mode.
    """
    try:
        mode, srgb = _properties(profile)
        if image.mode != mode:
            raise UnusableProfileError(f"it is for {mode or 'other'} pixels, not {image.mode}")
        return None if srgb else _converted(image, profile)
    except (ImageCms.PyCMSError, OSError, ValueError, TypeError) as error:
        raise UnusableProfileError(str(error).split("\n")[0][:80]) from error


@functools.lru_cache(16)
def _properties(profile: bytes) -> tuple[str, bool]:
    """Return the mode that a profile belongs to, and True where it is sRGB."""
    opened: Any = ImageCms.ImageCmsProfile(io.BytesIO(profile)).profile
    space = opened.xcolor_space.strip()
    mode = MODES.get(space, "")
    if mode != "RGB":
        return mode, False
    levels = np.linspace(0, 255, STEPS).round().astype(np.uint8)
    grid = np.stack(np.meshgrid(levels, levels, levels), -1).reshape(STEPS, -1, 3)
    change = np.asarray(_converted(Image.fromarray(grid), profile)).astype(int) - grid
    return mode, bool(np.abs(change).max() <= SAME)


def _converted(image: Image.Image, profile: bytes) -> Image.Image:
    """Convert an image to sRGB with relative colorimetric intent, which keeps all colours within sRGB's gamut."""
    source = ImageCms.ImageCmsProfile(io.BytesIO(profile))
    intent = ImageCms.Intent.RELATIVE_COLORIMETRIC
    made = ImageCms.profileToProfile(image, source, ImageCms.createProfile("sRGB"), renderingIntent=intent, outputMode="RGB")
    if made is None:
        raise UnusableProfileError("it can't be applied")
    return made
