# SPDX-License-Identifier: GPL-3.0-or-later
"""World frame of a capture: the object stands on Z = 0, its front faces -Y, and lengths are metres where a marker tells them."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ..datasets.up_direction import estimate_up, rotation_to_z
from ..scene.camera import Camera
from ..scene.dataset import Bound

MIN_WALL_ANGLE = 75.0  # degrees between the cameras' up and the normal of a surface from which it is a wall


def is_wall(cameras: Sequence[Camera], normal: np.ndarray) -> bool:
    """Return True where a surface stands upright for those who photographed it.

    Args:
        cameras: cameras in the model's frame.
        normal: (3,) unit normal of the surface, in the same frame.
    """
    up = estimate_up(cameras)
    return bool(up @ normal < np.cos(np.radians(MIN_WALL_ANGLE)) * np.linalg.norm(up))


def world_similarity(
    cameras: Sequence[Camera], bound: Bound, plane: tuple[np.ndarray, float] | None, metres_per_unit: float | None
) -> np.ndarray:
    """Return the similarity (4, 4) from the model's frame to the world.

    Without a plane, the cameras' up becomes +Z and the object's centre the origin. The first camera, where most people begin with the
    front, ends up at -Y. Without a marker, the object's radius becomes 1.

    Args:
        cameras: cameras in the model's frame, in the order of the photographs.
        bound: bounding sphere of the object in the model's frame.
        plane: (unit normal (3,) that points to the cameras, offset) of the plane n . x = offset that the object stands on, or None.
        metres_per_unit: size of the model's unit by a marker, or None.
    """
    centre = np.asarray(bound.centre)
    up = np.asarray(plane[0], np.float64) if plane else estimate_up(cameras)
    origin = centre - (centre @ up - plane[1]) * up if plane else centre
    rotation = _turned_to_front(rotation_to_z(up / np.linalg.norm(up)), cameras[0].centre - centre)
    scale = metres_per_unit or 1 / bound.radius
    similarity = np.eye(4)
    similarity[:3, :3] = scale * rotation
    similarity[:3, 3] = -scale * rotation @ origin
    return similarity


def _turned_to_front(rotation: np.ndarray, towards: np.ndarray) -> np.ndarray:
    """Return the rotation (3, 3) turned about Z so that the direction `towards` (3,) ends up above -Y."""
    x, y, _ = rotation @ towards
    length = np.hypot(x, y)
    if length < 1e-6 * np.linalg.norm(towards):
        return rotation  # the camera looks straight down
    cosine, sine = -y / length, -x / length
    return np.array([[cosine, -sine, 0], [sine, cosine, 0], [0, 0, 1]]) @ rotation
