# SPDX-License-Identifier: GPL-3.0-or-later
"""Surroundings of an object that was photographed where it stands: a patterned table under it."""

from __future__ import annotations

import bpy
import numpy as np

from .mesh_objects import finished
from .shader_nodes import dielectric

PATTERN = [(0.36, (0.30, 0.24, 0.18)), (0.46, (0.55, 0.50, 0.42)), (0.54, (0.16, 0.22, 0.26)), (0.64, (0.62, 0.40, 0.28))]
WIDTH = 5.0  # of the table in radii of the object
# Place on the table and half side of boxes around the object, in its radii.
BOXES = ((1.9, 1.3, 0.42), (-2.0, 1.2, 0.33), (-1.6, -1.7, 0.38), (2.0, -1.6, 0.25))


def add_table(corners: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Put a square table under an object.

    Args:
        corners: corners of the object's triangles (N, 3).

    Returns:
        Points on the table (P, 3) in a grid, and their normals (P, 3).
    """
    low, high = corners.min(0), corners.max(0)
    centre, radius = (low + high) / 2, float(np.linalg.norm(high - low)) / 2
    place = (centre[0], centre[1], low[2])
    bpy.ops.mesh.primitive_plane_add(size=WIDTH * radius, location=place)
    finished(bpy.context.object, dielectric("table", (3.0 / radius, 5.0), PATTERN, (0.5, 0.7), detail=4.0), smooth=False)
    across = np.linspace(-0.5, 0.5, 40) * WIDTH * radius
    x, y = np.meshgrid(across, across)
    points = np.stack([x, y, np.zeros_like(x)], -1).reshape(-1, 3) + place
    return points, np.tile([0.0, 0.0, 1.0], (len(points), 1))


def add_desk(corners: np.ndarray) -> list[bpy.types.Object]:
    """Put a table with patterned boxes under and around an object, and return them; arguments as of `add_table`."""
    low, high = corners.min(0), corners.max(0)
    centre, radius = (low + high) / 2, float(np.linalg.norm(high - low)) / 2
    add_table(corners)
    things = [bpy.context.object]
    for number, (x, y, side) in enumerate(BOXES):
        place = (centre[0] + x * radius, centre[1] + y * radius, low[2] + side * radius)
        bpy.ops.mesh.primitive_cube_add(size=2 * side * radius, location=place, rotation=(0.0, 0.0, 0.7 * number))
        stops = [(position, tuple(np.roll(colour, number + 1))) for position, colour in PATTERN]
        material = dielectric(f"box {number}", (4.0 / radius, 20.0 + 3 * number), stops, (0.4, 0.7))
        things.append(finished(bpy.context.object, material, smooth=False))
    return things
