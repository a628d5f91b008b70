# SPDX-License-Identifier: GPL-3.0-or-later
"""How an imported dataset or run lies in Blender's world: one transform on the empty above everything."""

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
    """What a person chose on importing.

    Attributes:
        up_axis: "AS_IS" keeps the upright frame that the engine found; "Y_UP" and so on turn that axis of the dataset's own frame to
            +Z. So "Z_UP" at scale 1 is the dataset's own frame.
        scale: size in Blender, relative to the dataset's units.
        recentre: the object's middle comes to the origin.
    """

    up_axis: str = "AS_IS"
    scale: float = 1.0
    recentre: bool = False

    def matrix(self, to_world: np.ndarray, centre: Sequence[float]) -> np.ndarray:
        """(4, 4) from the engine's frame, which the imported things are stored in, to Blender's world.

        `to_world` (4, 4) leads from the dataset's own frame to the engine's; `centre` is the object's middle in the engine's.
        """
        if self.up_axis != "AS_IS" and self.up_axis not in AXES:
            raise InputError(self.up_axis, "is no way up", f"use AS_IS, {', '.join(AXES)}")
        matrix = np.eye(4)
        if self.up_axis != "AS_IS":
            matrix[:3, :3] = rotation_to_z(np.array(AXES[self.up_axis], float))
            matrix = matrix @ np.linalg.inv(to_world)
        matrix[:3] *= self.scale
        if self.recentre:
            matrix[:3, 3] -= (matrix @ [*centre, 1.0])[:3]
        return matrix


def place(root: bpy.types.Object, chosen: Placement, to_world: np.ndarray, centre: Sequence[float]) -> None:
    """Put the empty where the choice says; where it stands already by the same choice it is left, as a person may have moved it."""
    words = f"{chosen.up_axis} {chosen.scale:.9g} {chosen.recentre}"
    if root.get(CHOSEN) != words:
        root.matrix_world = Matrix(chosen.matrix(to_world, centre).tolist())
        root[CHOSEN] = words
    root[TO_WORLD] = np.asarray(to_world, float).reshape(-1).tolist()


def place_beside(root: bpy.types.Object, other: bpy.types.Object, to_world: np.ndarray) -> None:
    """Put the empty so that what is below it covers what is below another one of the same dataset."""
    between = Matrix(np.array(other[TO_WORLD]).reshape(4, 4) @ np.linalg.inv(to_world))
    root.matrix_world = other.matrix_world @ between
    root[CHOSEN], root[TO_WORLD] = other[CHOSEN], np.asarray(to_world, float).reshape(-1).tolist()


def to_dataset(root: bpy.types.Object) -> Matrix:
    """From Blender's world to the dataset's own frame, wherever the empty has been moved since."""
    own = Matrix(np.linalg.inv(np.array(root[TO_WORLD]).reshape(4, 4)).tolist())
    return own @ root.matrix_world.inverted()
