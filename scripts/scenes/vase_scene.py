# SPDX-License-Identifier: GPL-3.0-or-later
"""Scene of polished metal: a silver vase that stands in a brass ring, with a ball beside it."""

from __future__ import annotations

import bpy
import numpy as np

from .mesh_objects import empty_file, finished, revolved
from .shader_nodes import dielectric, metal

OUTLINE = [(0.0, -1.0), (0.42, -1.0), (0.46, -0.94), (0.62, -0.55), (0.66, -0.2), (0.52, 0.25), (0.28, 0.55), (0.24, 0.75), (0.40, 0.98)]
LIP = [(0.42, 1.02), (0.38, 1.04), (0.18, 0.85), (0.0, 0.8)]
GLAZE = [(0.38, (0.05, 0.12, 0.30)), (0.47, (0.30, 0.42, 0.55)), (0.55, (0.70, 0.62, 0.50)), (0.63, (0.50, 0.16, 0.08))]
MATERIALS = {
    "glossy": lambda: (
        metal("silver", (0.93, 0.91, 0.87), (0.10, 0.25), offset=3.0),
        metal("brass", (0.86, 0.62, 0.27), (0.18, 0.32), offset=9.0),
    ),
    "mixed": lambda: (
        dielectric("glaze", (2.6, 4.0), GLAZE, (0.25, 0.45), detail=2.0),
        metal("brass", (0.86, 0.62, 0.27), (0.18, 0.32), offset=9.0),
    ),
}


def build_vase_scene(kind: str = "glossy") -> list[bpy.types.Object]:
    """Fill an empty file with the vase, its ring and the ball, inside radius 1.3 around the origin, and return them.

    Args:
        kind: one of MATERIALS.
    """
    empty_file()
    body, trim = MATERIALS[kind]()
    vase = finished(revolved("vase", _smooth_outline()), body)
    bpy.ops.mesh.primitive_torus_add(location=(0, 0, -0.9), major_radius=0.72, minor_radius=0.1, major_segments=96, minor_segments=32)
    ring = finished(bpy.context.object, trim)
    bpy.ops.mesh.primitive_uv_sphere_add(radius=0.2, location=(0.72, 0.38, -0.62), segments=64, ring_count=32)
    return [vase, ring, finished(bpy.context.object, trim)]


def _smooth_outline(steps: int = 90) -> np.ndarray:
    """Return the outline of the vase, radius and height (steps, 2), rounded between its points."""
    points = np.array([*OUTLINE, *LIP])
    length = np.concatenate([[0.0], np.linalg.norm(np.diff(points, axis=0), axis=1).cumsum()])
    at = np.linspace(0, length[-1], 8 * steps)
    fine = np.stack([np.interp(at, length, column) for column in points.T], -1)
    window = np.hanning(49)[:, None] / np.hanning(49).sum()
    padded = np.concatenate([np.repeat(fine[:1], 24, 0), fine, np.repeat(fine[-1:], 24, 0)])
    rounded = np.stack([np.convolve(column, window[:, 0], "valid") for column in padded.T], -1)[::8]
    rounded[[0, -1], 0] = 0.0
    return rounded
