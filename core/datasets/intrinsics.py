# SPDX-License-Identifier: GPL-3.0-or-later
"""Parsing of camera intrinsics in the transforms.json family."""

from __future__ import annotations

import math
from typing import Any

from ..errors import InputError
from .parsed_dataset import Lens

RADIAL_MODELS = ("PINHOLE", "SIMPLE_PINHOLE", "SIMPLE_RADIAL", "RADIAL", "OPENCV")
FISHEYE_MODEL = "OPENCV_FISHEYE"
LARGEST_SIDE = 1 << 20

Size = tuple[int, int]


def parse_lens(where: str, values: dict[str, Any], size: Size | None) -> Lens:
    """Parse the intrinsics of a frame.

    Args:
        where: file and frame, for messages.
        values: the frame's values, with those shared by all frames.
        size: (width, height) in pixels to use if the values don't state it.

    Raises:
        InputError: if a value is missing or impossible.
    """
    width, height = (parse_side(where, values, k, i, size) for i, k in enumerate(("w", "h")))
    if is_given(values, "fl_x"):
        fx = parse_number(where, values, "fl_x")
        fy = parse_number(where, values, "fl_y") if is_given(values, "fl_y") else fx
    elif is_given(values, "camera_angle_x"):
        fx = _focal_length(where, values, "camera_angle_x", width)
        fy = parse_number(where, values, "fl_y") if is_given(values, "fl_y") else fx
    else:
        raise InputError(where, 'has neither "fl_x" nor "camera_angle_x"')
    cx = parse_number(where, values, "cx") if is_given(values, "cx") else width / 2
    cy = parse_number(where, values, "cy") if is_given(values, "cy") else height / 2
    model, distortion, fisheye = _distortion(where, values)
    return Lens(model, width, height, fx, fy, cx, cy, distortion, fisheye).checked(where)


def _distortion(where: str, values: dict[str, Any]) -> tuple[str, tuple[float, ...], bool]:
    """Parse the lens distortion; return (model name, coefficients in OpenCV's order, fisheye)."""
    k = {n: parse_number(where, values, n) if is_given(values, n) else 0.0 for n in ("k1", "k2", "k3", "k4", "p1", "p2")}
    assumed = FISHEYE_MODEL if values.get("is_fisheye") is True else "OPENCV" if any(k.values()) else "PINHOLE"
    model = values.get("camera_model", assumed)
    if model == FISHEYE_MODEL:
        return model, (k["k1"], k["k2"], k["k3"], k["k4"]), True
    if model not in RADIAL_MODELS:
        known = ", ".join((*RADIAL_MODELS, FISHEYE_MODEL))
        raise InputError(where, f"has an unknown camera model {str(model)[:40]!r}", f"known are {known}")
    if k["k4"]:
        raise InputError(where, f"has k4 with the camera model {model}", "k4 belongs to OPENCV_FISHEYE")
    coefficients = (k["k1"], k["k2"], k["p1"], k["p2"], k["k3"])
    return model, coefficients if any(coefficients) and "PINHOLE" not in model else (), False


def is_given(values: dict[str, Any], key: str) -> bool:
    """Return True if the values have the key and its value is not null.

    Args:
        values: values of a frame.
        key: name of the value.
    """
    return values.get(key) is not None


def parse_number(where: object, values: dict[str, Any], key: str) -> float:
    """Parse a number.

    Args:
        where: file and frame, for messages.
        values: values of a frame.
        key: name of the value, which must exist.

    Raises:
        InputError: if it is not a number, or not finite.
    """
    value = values[key]
    if isinstance(value, bool) or not isinstance(value, (int, float)):
        raise InputError(where, f'"{key}" is not a number')
    try:
        number = float(value)
    except OverflowError:
        number = math.inf
    if not math.isfinite(number):
        raise InputError(where, f'"{key}" is not finite')
    return number


def parse_side(where: object, values: dict[str, Any], key: str, axis: int = 0, size: Size | None = None) -> int:
    """Parse a side of an image in pixels.

    Args:
        where: file and frame, for messages.
        values: values of a frame.
        key: name of the value.
        axis: index of the side in `size`.
        size: (width, height) in pixels to use if the values don't state it.

    Raises:
        InputError: if the side is neither stated nor known from `size`, or is not a possible size.
    """
    if not is_given(values, key):
        if size is None:
            raise InputError(where, "none of the images can be read, so their size is unknown", f'copy them again, or state "{key}"')
        return size[axis]
    side = parse_number(where, values, key)
    if not 1 <= side <= LARGEST_SIDE or side != int(side):
        raise InputError(where, f'"{key}" = {side:g} is not an image size')
    return int(side)


def _focal_length(where: str, values: dict[str, Any], key: str, pixels: int) -> float:
    angle = parse_number(where, values, key)
    if not 0 < angle < math.pi:
        raise InputError(where, f'"{key}" = {angle:g} is not between 0 and pi')
    return 0.5 * pixels / math.tan(0.5 * angle)
