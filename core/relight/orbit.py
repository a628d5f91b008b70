# SPDX-License-Identifier: GPL-3.0-or-later
"""Cameras on a circle around an object, for turntables."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np

from ..errors import InputError
from ..scene.camera import Camera
from ..scene.dataset import Bound

ELEVATION = 20.0  # degrees above the horizon


def orbit(count: int, cameras: Sequence[Camera], bound: Bound, elevation: float = ELEVATION) -> list[tuple[str, Camera]]:
    """`count` named cameras on a full circle about +Z around the bound's centre, the first at azimuth 0 (+X), counter-clockwise from above.

    Image size and lens are those of the first of `cameras`, the distance is their median one. Raises InputError for fewer than 1.
    """
    if count < 1:
        raise InputError("--orbit", f"{count} is no number of views", "use 1 or more")
    centre = np.array(bound.centre)
    distance = float(np.median([np.linalg.norm(camera.centre - centre) for camera in cameras]))
    digits = max(3, len(str(count - 1)))
    angles = np.arange(count) * (2 * np.pi / count)
    return [(f"orbit_{i:0{digits}}", _placed(cameras[0], centre, distance, a, np.radians(elevation))) for i, a in enumerate(angles)]


def _placed(camera: Camera, centre: np.ndarray, distance: float, azimuth: float, elevation: float) -> Camera:
    back = np.array([np.cos(elevation) * np.cos(azimuth), np.cos(elevation) * np.sin(azimuth), np.sin(elevation)])
    right = np.array([-np.sin(azimuth), np.cos(azimuth), 0.0])
    to_world = np.eye(4)
    to_world[:3] = np.stack([right, np.cross(back, right), back, centre + distance * back], 1)
    return dataclasses.replace(camera, to_world=to_world)
