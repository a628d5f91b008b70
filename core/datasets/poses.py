# SPDX-License-Identifier: GPL-3.0-or-later
"""Camera poses as files state them, made exactly rigid."""

from __future__ import annotations

from typing import Any

import numpy as np

from ..errors import InputError
from .parsed_dataset import FARTHEST

RIGID_TOLERANCE = 1e-3


def pose_of(where: str, entry: dict[str, Any]) -> np.ndarray:
    """(4, 4) camera to world of a frame of a transforms file, made exactly rigid. Raises InputError where it is none."""
    if "transform_matrix" not in entry:
        raise InputError(where, 'has no "transform_matrix"')
    try:
        matrix = np.array(entry["transform_matrix"], np.float64)
    except (TypeError, ValueError, OverflowError) as error:
        raise InputError(where, "transform_matrix is not a matrix of numbers") from error
    return rigid(where, matrix, "transform_matrix")


def rigid(where: object, matrix: np.ndarray, name: str) -> np.ndarray:
    """The (4, 4) or (3, 4) matrix as (4, 4) with its rotation made exact; `name` is what the file calls it.

    Raises InputError where it is not finite or not a rotation and a translation.
    """
    if matrix.shape == (3, 4):
        matrix = np.vstack([matrix, [0, 0, 0, 1]])
    if matrix.shape != (4, 4):
        raise InputError(where, f"{name} has shape {matrix.shape}, not 4x4")
    if not np.isfinite(matrix).all():
        raise InputError(where, f"{name} is not finite (NaN or infinity)")
    turn = matrix[:3, :3]
    if np.abs(turn).max() > 2 or np.abs(turn @ turn.T - np.eye(3)).max() > RIGID_TOLERANCE or np.linalg.det(turn) < 0:
        raise InputError(where, f"{name} is not rigid (scaled, sheared or mirrored)", "only rotation and translation are allowed")
    if np.abs(matrix[3] - [0, 0, 0, 1]).max() > RIGID_TOLERANCE:
        raise InputError(where, f"{name} has a last row other than 0 0 0 1")
    if np.abs(matrix[:3, 3]).max() > FARTHEST:
        raise InputError(where, f"{name} puts the camera at infinity")
    u, _, vt = np.linalg.svd(turn)
    exact = np.eye(4)
    exact[:3, :3], exact[:3, 3] = u @ vt, matrix[:3, 3]
    return exact
