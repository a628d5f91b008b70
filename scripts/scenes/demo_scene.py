# SPDX-License-Identifier: GPL-3.0-or-later
"""Scene of the embedded dataset: Blender's monkey in a mottled glaze on a copper ring; or both of one material."""

from __future__ import annotations

from math import radians

import bpy

from .mesh_objects import empty_file, finished
from .shader_nodes import dielectric, metal

KINDS = {
    "mixed": ("glaze", "copper"),
    "low-gloss": ("glaze", "glaze"),
    "glossy": ("copper", "copper"),
}  # materials of the monkey and of the ring
PATCHES = [(0.40, (0.03, 0.22, 0.26)), (0.48, (0.62, 0.55, 0.42)), (0.55, (0.62, 0.20, 0.06)), (0.64, (0.10, 0.16, 0.42))]


def build_demo_scene(kind: str = "mixed") -> list[bpy.types.Object]:
    """Fill an empty file with the demonstration's objects, inside radius 1.3 around the origin, and return them.

    Args:
        kind: one of KINDS.
    """
    empty_file()
    bpy.ops.mesh.primitive_monkey_add(size=1.75, location=(0.0, 0.05, 0.08), rotation=(radians(-18), 0.0, 0.0))
    monkey = bpy.context.object
    subdivision = monkey.modifiers.new("subdivision", "SUBSURF")
    subdivision.levels = subdivision.render_levels = 2
    bpy.ops.mesh.primitive_torus_add(location=(0.0, -0.02, -0.6), major_radius=0.55, minor_radius=0.18, major_segments=64)
    ring = bpy.context.object
    materials = {
        "glaze": dielectric("glaze", (1.15, 3.0), PATCHES, (0.3, 0.65)),
        "copper": metal("copper", (0.90, 0.48, 0.28), (0.18, 0.38), offset=7.0),
    }
    return [finished(thing, materials[name]) for thing, name in zip((monkey, ring), KINDS[kind], strict=True)]
