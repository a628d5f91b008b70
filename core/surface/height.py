# SPDX-License-Identifier: GPL-3.0-or-later
"""Height texture of a mesh of few triangles: distances along its normals to the finer surface that it stands for."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..io.quantisation import sixteen_bits
from ..scene.mesh import Mesh
from ..scene.surface import Surface
from .mesh_texels import mesh_texels
from .meshing import unit
from .nearest_hits import NearestTracer

FULL = 0.9  # of the fine surface's triangles: a mesh of as many was not reduced
LEAST = 0.1  # voxels: heights whose 99th percentile is smaller are noise of the fusion, not shape
MIDLEVEL = 0.5  # value of height 0, as in Blender's Displacement node


@dataclass(frozen=True, eq=False)
class HeightMap:
    """Heights above a mesh as an image.

    Attributes:
        image: (T, T) uint16; height = scale * (image / 65535 - MIDLEVEL), along the mesh's normal.
        scale: range of heights between the values 0 and 65535, world units.
        missed: fraction of the texels along whose normal no surface lies; their height is 0.
    """

    image: np.ndarray
    scale: float
    missed: float

    def state(self) -> dict[str, float]:
        """Return what run.json records: scale (world units), midlevel and missed."""
        return {"scale": float(f"{self.scale:.6g}"), "midlevel": MIDLEVEL, "missed": round(self.missed, 4)}


def height_line(state: dict[str, float] | None) -> str:
    """Return the record of the heights as one line for the user; None where there are none."""
    if state is None:
        return "no height texture: the mesh has all the shape of the fused surface; bake fewer triangles for one"
    return f"height texture: scale {state['scale']}, midlevel {state['midlevel']}"


def height_map(mesh: Mesh, fine: Surface, size: int) -> HeightMap | None:
    """Measure the height of a fine surface above each texel of a mesh.

    Args:
        mesh: of few triangles, with UVs and normals.
        fine: surface that it stands for, in the same world.
        size: texels along a side of the texture.

    Returns:
        The heights; None where the mesh has about as many triangles, or follows the fine surface to `LEAST` voxels.
    """
    if len(mesh.faces) >= FULL * len(fine.faces):
        return None
    texels = mesh_texels(mesh.vertices, mesh.uvs, mesh.faces, size)
    tracer, heights = NearestTracer(fine), np.empty(len(texels.index), np.float32)
    for part in texels.chunks():
        normal = unit(texels.interpolate(mesh.normals, mesh.faces, part))
        heights[part] = tracer.hits(texels.interpolate(mesh.vertices, mesh.faces, part), normal).height
    found = np.isfinite(heights)
    heights[~found] = 0
    if np.percentile(np.abs(heights), 99) < LEAST * fine.voxel:
        return None
    scale = 2 * float(np.abs(heights).max())
    return HeightMap(texels.image(sixteen_bits(MIDLEVEL + heights / scale)), scale, 1 - float(found.mean()))
