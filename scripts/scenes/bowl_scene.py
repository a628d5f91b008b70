# SPDX-License-Identifier: GPL-3.0-or-later
"""Scene of the kind "hollow": a thick-walled bowl with a block, a ball and a brass ring, which views from above alone see."""

from __future__ import annotations

from math import radians

import bpy
import numpy as np

from .mesh_objects import empty_file, finished, revolved
from .shader_nodes import dielectric, metal

INNER, OUTER = (0.96, 0.84), (1.09, 0.97)  # radius and depth of the walls' two sides
RIM = 0.32  # height of the rim
FULLNESS = 0.7  # exponent of the walls' superellipse: below 1, the floor is flatter and the walls are steeper than an ellipsoid's
GLAZE = [
    (0.34, (0.05, 0.16, 0.20)),
    (0.44, (0.20, 0.42, 0.40)),
    (0.50, (0.66, 0.58, 0.42)),
    (0.58, (0.60, 0.34, 0.14)),
    (0.66, (0.22, 0.08, 0.05)),
]
SPECKLES = [(0.38, (0.08, 0.13, 0.40)), (0.48, (0.20, 0.34, 0.62)), (0.56, (0.70, 0.68, 0.60)), (0.64, (0.62, 0.44, 0.10))]
MARBLING = [(0.36, (0.45, 0.03, 0.03)), (0.50, (0.66, 0.12, 0.06)), (0.62, (0.75, 0.36, 0.18))]


def build_bowl_scene() -> list[bpy.types.Object]:
    """Fill an empty file with the bowl and the things in it, inside radius 1.3 around the origin, and return them."""
    empty_file()
    glaze = dielectric("bowl", (8.0, 2.0), GLAZE, (0.35, 0.6), detail=3.0)
    bowl = finished(revolved("bowl", bowl_profile()), glaze)
    bpy.ops.mesh.primitive_cube_add(size=0.42, location=(-0.34, -0.06, -0.29), rotation=(radians(4), radians(6), radians(28)))
    block = finished(_bevelled(bpy.context.object), dielectric("block", (6.0, 5.0), SPECKLES, (0.5, 0.7), detail=2.0))
    bpy.ops.mesh.primitive_uv_sphere_add(radius=0.25, location=(0.30, 0.32, -0.24), segments=64, ring_count=32)
    ball = finished(bpy.context.object, dielectric("ball", (4.5, 13.0), MARBLING, (0.28, 0.42), detail=3.0))
    turned = radians(62), radians(8), radians(-24)
    bpy.ops.mesh.primitive_torus_add(
        location=(0.27, -0.34, -0.30), rotation=turned, major_radius=0.2, minor_radius=0.06, major_segments=96, minor_segments=32
    )
    ring = finished(bpy.context.object, metal("brass", (0.86, 0.62, 0.27), (0.22, 0.36), offset=4.0))
    return [bowl, block, ball, ring]


def bowl_profile(steps: int = 64) -> np.ndarray:
    """Return the outline of the wall from the outer pole over the rim to the inner pole, radius and height, (2 * steps + 14, 2).

    Args:
        steps: points along each side of the wall.
    """
    outer, inner = (_wall(*sizes, steps) for sizes in (OUTER, INNER))
    angle = np.linspace(0, np.pi, 16)[1:-1]
    half = (OUTER[0] - INNER[0]) / 2
    rim = np.stack([INNER[0] + half + half * np.cos(angle), RIM + half * np.sin(angle)], -1)
    return np.concatenate([outer, rim, inner[::-1]])


def _wall(radius: float, depth: float, steps: int) -> np.ndarray:
    """Return a quarter of a superellipse from its lowest point to the rim, radius and height, (steps, 2)."""
    angle = np.linspace(0, np.pi / 2, steps)
    across, down = np.sin(angle) ** FULLNESS, np.clip(np.cos(angle), 0, 1) ** FULLNESS
    down[-1] = 0.0
    return np.stack([radius * across, RIM - depth * down], -1)


def _bevelled(thing: bpy.types.Object) -> bpy.types.Object:
    """Round the edges of an object a little, by a modifier, and return it."""
    bevel = thing.modifiers.new("bevel", "BEVEL")
    bevel.width, bevel.segments, bevel.harden_normals = 0.03, 4, True
    return thing
