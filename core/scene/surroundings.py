# SPDX-License-Identifier: GPL-3.0-or-later
"""Surroundings of an object: near surfaces such as a table, which shadow and light it but are no part of the asset."""

from __future__ import annotations

import io
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ..errors import InputError
from ..io.atomic import write_atomic
from ..io.npz import read_arrays
from .similarity import moved_points, scale_of

MIN_GROUND_POINTS = 50  # points that make a support plane
MAX_GROUND_HEIGHT, MIN_NORMAL_Z = 0.01, 0.999  # their largest height over Z = 0, in their spacing, and least Z of their normals
ARRAYS = {"position": (3,), "normal": (3,), "radiance": (3,), "spacing": ()}


@dataclass(frozen=True, eq=False)
class Surroundings:
    """Points on the surfaces around an object.

    Attributes:
        position: (N, 3) float32 world.
        normal: (N, 3) float32 unit.
        radiance: (N, 3) float32 linear, that the photographs show, the same in all directions.
        spacing: (N,) float32 distance of neighbouring points, world units.
    """

    position: np.ndarray
    normal: np.ndarray
    radiance: np.ndarray
    spacing: np.ndarray

    @property
    def has_ground(self) -> bool:
        """True where the plane Z = 0 is part of them: the object stands on it."""
        flat = (np.abs(self.position[:, 2]) < MAX_GROUND_HEIGHT * self.spacing) & (self.normal[:, 2] > MIN_NORMAL_Z)
        return int(flat.sum()) >= MIN_GROUND_POINTS

    def moved(self, similarity: np.ndarray) -> Surroundings:
        """Return the surroundings after a similarity (4, 4) of the world: distances scale with it, radiance stays."""
        scale = scale_of(similarity)
        position, normal = moved_points(self.position, similarity), self.normal @ (similarity[:3, :3] / scale).T
        return Surroundings(*(a.astype(np.float32) for a in (position, normal, self.radiance, scale * self.spacing)))


def save_surroundings(surroundings: Surroundings, path: Path) -> None:
    """Write the points as an .npz, atomically.

    Args:
        surroundings: the points.
        path: the file.
    """
    data = io.BytesIO()
    np.savez(data, **{name: np.ascontiguousarray(getattr(surroundings, name), np.float32) for name in ARRAYS})
    write_atomic(path, data.getvalue())


def load_surroundings(path: Path) -> Surroundings:
    """Read the points that `save_surroundings` wrote.

    Raises:
        InputError: if the file is missing or damaged.
    """
    arrays = read_arrays(path, *ARRAYS)
    count = len(arrays[0])
    for array, (name, shape) in zip(arrays, ARRAYS.items(), strict=True):
        if array.shape != (count, *shape) or array.dtype != np.float32 or not np.isfinite(array).all():
            raise InputError(path, f"has a damaged array {name}", "run irgspp capture again")
    if (arrays[2] < 0).any() or (arrays[3] <= 0).any():
        raise InputError(path, "has a negative radiance or spacing", "run irgspp capture again")
    return Surroundings(*(array.copy() for array in arrays))  # writable, as torch wants them
