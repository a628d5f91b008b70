# SPDX-License-Identifier: GPL-3.0-or-later
"""Orbit cameras: a circle of views around an object, for turntables."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np

from ..errors import InputError
from ..scene.camera import Camera
from ..scene.dataset import Bound

ELEVATION = 20.0  # degrees above the horizon


def orbit(count: int, cameras: Sequence[Camera], bound: Bound, elevation: float = ELEVATION) -> list[tuple[str, Camera]]:
    """Place cameras on a full circle about +Z around the bound's centre.

    The first stands at azimuth 0 (+X), the others follow counter-clockwise seen from above. Image size and lens are those of the first of
    `cameras`; the distance is the median of theirs.

    Args:
        count: number of cameras.
        cameras: cameras of the reconstruction.
        bound: sphere around the object.
        elevation: degrees above the horizon.

    Returns:
        Names and cameras.

    Raises:
        InputError: when the count is below 1.
    """
    if count < 1:
        raise InputError("--orbit", f"the number of views must be at least 1, got {count}", "use 1 or more")
    centre = np.array(bound.centre)
    distance = float(np.median([np.linalg.norm(camera.centre - centre) for camera in cameras]))
    digits = max(3, len(str(count - 1)))
    angles = np.arange(count) * (2 * np.pi / count)
    return [(f"orbit_{i:0{digits}}", _orbit_camera(cameras[0], centre, distance, a, np.radians(elevation))) for i, a in enumerate(angles)]


def _orbit_camera(camera: Camera, centre: np.ndarray, distance: float, azimuth: float, elevation: float) -> Camera:
    """Return a camera with the template's lens that looks at the centre (3,); angles in radians."""
    back = np.array([np.cos(elevation) * np.cos(azimuth), np.cos(elevation) * np.sin(azimuth), np.sin(elevation)])
    right = np.array([-np.sin(azimuth), np.cos(azimuth), 0.0])
    to_world = np.eye(4)
    to_world[:3] = np.stack([right, np.cross(back, right), back, centre + distance * back], 1)
    return dataclasses.replace(camera, to_world=to_world)
