# SPDX-License-Identifier: GPL-3.0-or-later
"""EXIF of a photograph: orientation, focal length in pixels, exposure, and the camera with its lens."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from PIL import Image

ORIENTATION, MAKE, MODEL, EXIF_IFD = 0x0112, 0x010F, 0x0110, 0x8769
EXPOSURE_TIME, F_NUMBER, ISO, ISO_INDEX, ISO_SPEED = 0x829A, 0x829D, 0x8827, 0x8832, 0x8833
FOCAL, FOCAL_35, LENS_MODEL = 0x920A, 0xA405, 0xA434
PLANE_X, PLANE_UNIT, WIDTH, HEIGHT = 0xA20E, 0xA210, 0xA002, 0xA003
UNITS = {2: 25.4, 3: 10.0, 4: 1.0, 5: 0.001}  # millimetres of FocalPlaneResolutionUnit
DIAGONAL = math.hypot(36, 24)  # of 35 mm film, millimetres
TURNS = {1: (0, False), 2: (0, True), 3: (2, False), 4: (2, True), 5: (1, True), 6: (3, False), 7: (3, True), 8: (1, False)}
MAX_ISO16 = 65535  # in the 16-bit field of the sensitivity: too large for it, and stated elsewhere
POSSIBLE_FOCAL = (0.2, 100.0)  # focal length in long sides of the image: 136 to 0.6 degrees
POSSIBLE_TIME, POSSIBLE_F, POSSIBLE_ISO = (1e-6, 3600.0), (0.3, 200.0), (1.0, 1e7)  # seconds, f-number, ISO
MAX_FOCAL_RATIO = 1.15  # ratio up to which two statements of the focal length agree
MAX_NAME_LENGTH = 60  # characters of a name that are kept


@dataclass(frozen=True)
class Orientation:
    """Orientation of a photograph: how its stored pixels become upright.

    Attributes:
        turned: quarter turns anticlockwise, after the flip, 0..3.
        mirrored: True where the stored pixels are first flipped left to right.
    """

    turned: int = 0
    mirrored: bool = False

    def upright(self, pixels: np.ndarray) -> np.ndarray:
        """Turn stored pixels (H, W, ...) upright."""
        return np.ascontiguousarray(np.rot90(pixels[:, ::-1] if self.mirrored else pixels, self.turned))


@dataclass(frozen=True)
class Shot:
    """What EXIF says about a photograph.

    Attributes:
        orientation: orientation of the stored pixels.
        focal: focal length in pixels of the photograph, or None.
        exposure: exposure time x ISO / f-number^2, or None.
        lens: key of camera and lens, without the image's size.
        note: line for the user where EXIF is damaged; else empty.
    """

    orientation: Orientation = Orientation()
    focal: float | None = None
    exposure: float | None = None
    lens: str = ""
    note: str = ""


def read_shot(image: Image.Image) -> Shot:
    """Read the EXIF of an opened image; damaged EXIF counts as absent.

    Args:
        image: opened by Pillow; its pixels are not decoded.
    """
    try:
        exif = image.getexif()
        tags = {**exif, **exif.get_ifd(EXIF_IFD)}
        return shot_of(tags, *image.size)
    except Exception as error:  # Pillow raises struct.error, SyntaxError, OverflowError, ... for damaged EXIF
        return Shot(note=f"its EXIF is damaged and not used ({type(error).__name__})")


def shot_of(tags: Mapping[int, Any], width: int, height: int) -> Shot:
    """Evaluate EXIF tags.

    Args:
        tags: values of the main and the EXIF directory by their number.
        width: width of the stored image, pixels.
        height: height of the stored image, pixels.
    """
    return Shot(orientation_of(tags.get(ORIENTATION)), _focal(tags, width, height), _exposure(tags), _lens(tags))


def orientation_of(value: object) -> Orientation:
    """Return the orientation of an EXIF value 1..8; upright for anything else."""
    return Orientation(*TURNS.get(int(_number(value) or 1), TURNS[1]))


def lens_key(lens: str, width: int, height: int) -> str:
    """Return the key under which photographs share intrinsics: upright and lying copies of one camera differ in them.

    Args:
        lens: key of camera and lens, see `Shot`.
        width: width of the upright copy in pixels.
        height: height of the upright copy in pixels.
    """
    way = "square" if width == height else "landscape" if width > height else "portrait"
    return f"{lens or 'unknown camera'}|{max(width, height)}x{min(width, height)}|{way}"


def _focal(tags: Mapping[int, Any], width: int, height: int) -> float | None:
    """Return the focal length in pixels.

    The 35 mm equivalent is that of the same diagonal angle of view (CIPA DCG-001), in whole millimetres; the resolution of the sensor is
    more precise, but wrong after edits, so that it counts where both roughly agree.
    """
    diagonal, longest = math.hypot(width, height), max(width, height)
    film, plane = _positive(tags.get(FOCAL_35)), _plane_focal(tags, longest)
    film = film * diagonal / DIAGONAL if film else None
    if film and plane and not 1 / MAX_FOCAL_RATIO < plane / film < MAX_FOCAL_RATIO:
        plane = None
    focal = plane or film
    return focal if focal and POSSIBLE_FOCAL[0] < focal / longest < POSSIBLE_FOCAL[1] else None


def _plane_focal(tags: Mapping[int, Any], longest: int) -> float | None:
    """Return the focal length in pixels from millimetres and the resolution of the sensor."""
    focal, resolution = (_positive(tags.get(t)) for t in (FOCAL, PLANE_X))
    original = max(_positive(tags.get(WIDTH)) or 0, _positive(tags.get(HEIGHT)) or 0)
    unit = UNITS.get(int(_positive(tags.get(PLANE_UNIT)) or 2))
    if not focal or not resolution or not unit:
        return None
    return focal * resolution / unit * (longest / original if original else 1)


def _exposure(tags: Mapping[int, Any]) -> float | None:
    """Return exposure time x ISO / f-number^2 where all three are stated and possible."""
    iso = _positive(tags.get(ISO))
    if iso == MAX_ISO16:
        iso = _positive(tags.get(ISO_INDEX)) or _positive(tags.get(ISO_SPEED))
    time, stop = _positive(tags.get(EXPOSURE_TIME)), _positive(tags.get(F_NUMBER))
    if not time or not stop or not iso:
        return None
    possible = ((time, POSSIBLE_TIME), (stop, POSSIBLE_F), (iso, POSSIBLE_ISO))
    return time * iso / stop**2 if all(low <= value <= high for value, (low, high) in possible) else None


def _lens(tags: Mapping[int, Any]) -> str:
    """Return make, model, lens and focal length; empty where none is stated."""
    names = [_text(tags.get(t)) for t in (MAKE, MODEL, LENS_MODEL)]
    focal = _positive(tags.get(FOCAL))
    parts = [*names, f"{focal:.4g} mm" if focal else ""]
    return "|".join(parts) if any(parts) else ""


def _positive(value: object) -> float | None:
    """Return a value as a positive number; None where it is none."""
    number = _number(value)
    return number if number is not None and number > 0 else None


def _number(value: object) -> float | None:
    """Return a value, or the first of several, as a finite number; None where it is none."""
    if isinstance(value, (tuple, list)):
        value = value[0] if value else None
    try:
        number = float(value)  # pyright: ignore[reportArgumentType]
    except (TypeError, ValueError, ZeroDivisionError, OverflowError):
        return None
    return number if math.isfinite(number) else None


def _text(value: object) -> str:
    """Return a value as one line of text."""
    text = value.decode("latin-1") if isinstance(value, bytes) else value if isinstance(value, str) else ""
    return " ".join("".join(c if c.isprintable() else " " for c in text).replace("|", " ").split())[:MAX_NAME_LENGTH]
