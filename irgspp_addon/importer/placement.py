# SPDX-License-Identifier: GPL-3.0-or-later
"""Placement of an imported dataset or run in Blender's world, by one transform on the empty above all its objects."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import bpy
import numpy as np
from mathutils import Matrix

from ...core.datasets.up_direction import rotation_to_z
from ...core.errors import InputError

AXES = {"X_UP": (1, 0, 0), "Y_UP": (0, 1, 0), "Z_UP": (0, 0, 1), "NEG_X_UP": (-1, 0, 0), "NEG_Y_UP": (0, -1, 0), "NEG_Z_UP": (0, 0, -1)}
CHOSEN, TO_WORLD = "irgspp_placement", "irgspp_to_world"  # custom properties of the empty


@dataclass(frozen=True)
class Placement:
    """Placement chosen by the user at the import.

    Attributes:
        up_axis: "AS_IS" keeps the upright frame that the engine estimated; "Y_UP" and so on rotate that axis of the dataset's own frame
            to +Z. "Z_UP" with scale 1 is therefore the dataset's own frame.
        scale: scale in Blender, relative to the dataset's units.
        recentre: True to move the object's centre to the origin.
    """

    up_axis: str = "AS_IS"
    scale: float = 1.0
    recentre: bool = False

    def matrix(self, to_world: np.ndarray, centre: Sequence[float]) -> np.ndarray:
        """Return the (4, 4) matrix from the engine's frame, in which imported objects are stored, to Blender's world.

        Args:
            to_world: (4, 4) matrix from the dataset's own frame to the engine's frame.
            centre: (3,) centre of the object in the engine's frame.

        Raises:
            InputError: if `up_axis` is unknown.
        """
        if self.up_axis != "AS_IS" and self.up_axis not in AXES:
            raise InputError(self.up_axis, "is not a known up axis", f"use AS_IS, {', '.join(AXES)}")
        matrix = np.eye(4)
        if self.up_axis != "AS_IS":
            matrix[:3, :3] = rotation_to_z(np.array(AXES[self.up_axis], float))
            matrix = matrix @ np.linalg.inv(to_world)
        matrix[:3] *= self.scale
        if self.recentre:
            matrix[:3, 3] -= (matrix @ [*centre, 1.0])[:3]
        return matrix


def place(root: bpy.types.Object, chosen: Placement, to_world: np.ndarray, centre: Sequence[float]) -> None:
    """Set the transform of the empty, unless it was placed by the same choice before: the user may have moved it since.

    Args:
        root: empty above the imported objects.
        chosen: placement.
        to_world: (4, 4) matrix from the dataset's own frame to the engine's frame.
        centre: (3,) centre of the object in the engine's frame.
    """
    description = f"{chosen.up_axis} {chosen.scale:.9g} {chosen.recentre}"
    if root.get(CHOSEN) != description:
        root.matrix_world = Matrix(chosen.matrix(to_world, centre).tolist())
        root[CHOSEN] = description
    root[TO_WORLD] = np.asarray(to_world, float).reshape(-1).tolist()


def place_over(root: bpy.types.Object, other: bpy.types.Object, to_world: np.ndarray) -> None:
    """Place the empty of a run so that its objects coincide with those of the imported dataset.

    Args:
        root: empty of the run.
        other: empty of the dataset.
        to_world: (4, 4) matrix from the dataset's own frame to the run's frame.
    """
    between = Matrix(np.array(other[TO_WORLD]).reshape(4, 4) @ np.linalg.inv(to_world))
    root.matrix_world = other.matrix_world @ between
    root[CHOSEN], root[TO_WORLD] = other[CHOSEN], np.asarray(to_world, float).reshape(-1).tolist()


def to_dataset(root: bpy.types.Object) -> Matrix:
    """Return the matrix (4, 4) from Blender's world to the dataset's own frame, for the current position of the empty."""
    own = Matrix(np.linalg.inv(np.array(root[TO_WORLD]).reshape(4, 4)).tolist())
    return own @ root.matrix_world.inverted()
