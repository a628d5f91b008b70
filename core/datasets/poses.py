# SPDX-License-Identifier: GPL-3.0-or-later
"""Camera poses from files, checked and made exactly rigid."""

from __future__ import annotations

from typing import Any

import numpy as np

from ..errors import InputError
from .parsed_dataset import FARTHEST

RIGID_TOLERANCE = 1e-3


def parse_pose(where: str, entry: dict[str, Any]) -> np.ndarray:
    """Parse the pose of a frame of a transforms file.

    Args:
        where: file and frame, for messages.
        entry: the frame's values.

    Returns:
        (4, 4) camera to world, exactly rigid.

    Raises:
        InputError: if the matrix is missing or not rigid.
    """
    if "transform_matrix" not in entry:
        raise InputError(where, 'has no "transform_matrix"', "add it or remove the frame")
    try:
        matrix = np.array(entry["transform_matrix"], np.float64)
    except (TypeError, ValueError, OverflowError) as error:
        raise InputError(where, "transform_matrix is not a matrix of numbers") from error
    return rigid_pose(where, matrix, "transform_matrix")


def parse_light_rotation(where: object, value: Any) -> np.ndarray | None:
    """Parse the rotation of the light of a frame.

    Args:
        where: file and frame, for messages.
        value: three rows of three numbers, world to the frame of the light; None where the file states none.

    Returns:
        (3, 3) float64, exactly a rotation, or None.

    Raises:
        InputError: if it is not a rotation.
    """
    if value is None:
        return None
    try:
        rotation = np.array(value, np.float64)
    except (TypeError, ValueError, OverflowError) as error:
        raise InputError(where, "light_rotation is not a matrix of numbers") from error
    if rotation.shape != (3, 3):
        raise InputError(where, f"light_rotation has shape {rotation.shape}, not 3x3")
    pose = np.eye(4)
    pose[:3, :3] = rotation
    return rigid_pose(where, pose, "light_rotation")[:3, :3]


def rigid_pose(where: object, matrix: np.ndarray, name: str) -> np.ndarray:
    """Check that a matrix is a rotation and a translation, and make its rotation exact.

    Args:
        where: file and frame, for messages.
        matrix: (4, 4) or (3, 4).
        name: name of the matrix in the file.

    Returns:
        (4, 4) float64.

    Raises:
        InputError: if it is not finite or not rigid.
    """
    if matrix.shape == (3, 4):
        matrix = np.vstack([matrix, [0, 0, 0, 1]])
    if matrix.shape != (4, 4):
        raise InputError(where, f"{name} has shape {matrix.shape}, not 4x4")
    if not np.isfinite(matrix).all():
        raise InputError(where, f"{name} is not finite (NaN or infinity)")
    rotation = matrix[:3, :3]
    if np.abs(rotation).max() > 2 or np.abs(rotation @ rotation.T - np.eye(3)).max() > RIGID_TOLERANCE or np.linalg.det(rotation) < 0:
        raise InputError(where, f"{name} is not rigid (scaled, sheared or mirrored)", "only rotation and translation are allowed")
    if np.abs(matrix[3] - [0, 0, 0, 1]).max() > RIGID_TOLERANCE:
        raise InputError(where, f"{name} has a last row other than 0 0 0 1")
    if np.abs(matrix[:3, 3]).max() > FARTHEST:
        raise InputError(where, f"{name} puts the camera at infinity")
    u, _, vt = np.linalg.svd(rotation)
    exact = np.eye(4)
    exact[:3, :3], exact[:3, 3] = u @ vt, matrix[:3, 3]
    return exact
