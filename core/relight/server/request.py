# SPDX-License-Identifier: GPL-3.0-or-later
"""Parser of requests for images: JSON, checked before any work is done."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from ...errors import InputError
from ...scene.camera import Camera
from ...scene.lamps import read_lamps
from ..ground_shadow import Plane
from ..sample_counts import sample_counts
from .loaded_run import LightSource, Request

PIXELS = 1 << 28  # largest image


def read_request(values: Any, session: Path) -> Request:
    """Parse a request.

    {"number", "camera": {width, height, fx, fy, cx, cy, to_world (4 x 4)}, "light": null or {"map": .npy in the session folder,
    "turn": 9 numbers, "strength"}, "lamps": list (`core/scene/lamps.py`), "backdrop", "samples", "denoise", "indirect",
    "backend", "albedo_scale": [r, g, b], "progressive", "ground": null or a plane's unit normal and offset}

    Args:
        values: decoded JSON.
        session: session folder.

    Raises:
        InputError: when something is missing or invalid.
    """
    try:
        camera = _camera(values["camera"])
        light = _light(values["light"], session) if values.get("light") else None
        scale = tuple(float(factor) for factor in values.get("albedo_scale", (1, 1, 1)))
        options = {name: bool(values[name]) for name in ("denoise", "indirect", "progressive", "backdrop") if name in values}
        ground = _plane(values["ground"]) if values.get("ground") else None
        samples, backend, lamps = values.get("samples", 32), values.get("backend", "mesh"), values.get("lamps", [])
    except (KeyError, TypeError, ValueError) as error:
        raise InputError("request", f"can't be understood ({error!r})") from error
    if not isinstance(samples, int | str):
        raise InputError("request", f"samples must be a number, hq or efficient, got {samples}")
    if backend not in ("mesh", "gaussian") or len(scale) != 3 or not all(0 <= factor < float("inf") for factor in scale):
        raise InputError("request", f"backend {backend} must be mesh or gaussian, albedo scale {scale} three finite numbers >= 0")
    sample_counts(samples, metallic=False)
    return Request(camera, light, read_lamps(lamps), samples=samples, backend=backend, albedo_scale=scale, ground=ground, **options)


def _camera(values: dict[str, Any]) -> Camera:
    """Parse the camera; raise ValueError where it is invalid."""
    to_world = np.array(values["to_world"], float)
    numbers = [float(values[name]) for name in ("fx", "fy", "cx", "cy")]
    width, height = int(values["width"]), int(values["height"])
    if to_world.shape != (4, 4) or not np.isfinite(to_world).all() or not np.isfinite(numbers).all():
        raise ValueError("camera: to_world must be 4 x 4, and all numbers finite")
    if width < 1 or height < 1 or width * height > PIXELS or numbers[0] <= 0 or numbers[1] <= 0:
        raise ValueError(f"camera: invalid image of {width} x {height} pixels or focal lengths {numbers[:2]}")
    return Camera(width, height, numbers[0], numbers[1], numbers[2], numbers[3], to_world)


def _plane(values: Any) -> Plane:
    """Parse a plane; raise ValueError where it is invalid."""
    x, y, z, offset = (float(number) for number in values)
    if not np.isfinite((x, y, z, offset)).all() or abs(x * x + y * y + z * z - 1) > 1e-3:
        raise ValueError(f"ground: {values} is not a unit normal and an offset")
    return (x, y, z, offset)


def _light(values: dict[str, Any], session: Path) -> LightSource:
    """Parse the light; raise ValueError where it is invalid."""
    turn, strength = tuple(float(x) for x in values["turn"]), float(values["strength"])
    rows = np.array(turn).reshape(3, 3)
    if not np.allclose(rows @ rows.T, np.eye(3), atol=1e-3) or not 0 <= strength < float("inf"):
        raise ValueError(f"light: turn {turn} is not a rotation, or strength {strength} is not finite and >= 0")
    return LightSource(session / Path(values["map"]).name, turn, strength)
