# SPDX-License-Identifier: GPL-3.0-or-later
"""Height texture of a mesh of few triangles: distances along its normals to the finer surface that it stands for."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..io.quantisation import sixteen_bits
from ..scene.mesh import Mesh
from ..scene.surface import Surface
from ..scene.triangle_tracer import TriangleTracer
from .mesh_texels import mesh_texels
from .meshing import unit

REACH = 0.05  # of the mesh's diameter: farther along a normal, another part of the object would be found
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
    corners = fine.vertices[fine.faces]
    facing = unit(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]))
    tracer, reach = TriangleTracer(corners), REACH * float(np.linalg.norm(np.ptp(mesh.vertices, axis=0)))
    heights = np.empty(len(texels.index), np.float32)
    for part in texels.chunks():
        place = texels.interpolate(mesh.vertices, mesh.faces, part).astype(np.float32)
        normal = unit(texels.interpolate(mesh.normals, mesh.faces, part)).astype(np.float32)
        heights[part] = _nearest(tracer, facing, place, normal, reach)
    found = np.isfinite(heights)
    heights[~found] = 0
    if np.percentile(np.abs(heights), 99) < LEAST * fine.voxel:
        return None
    scale = 2 * float(np.abs(heights).max())
    return HeightMap(texels.image(sixteen_bits(MIDLEVEL + heights / scale)), scale, 1 - float(found.mean()))


def _nearest(tracer: TriangleTracer, facing: np.ndarray, place: np.ndarray, normal: np.ndarray, reach: float) -> np.ndarray:
    """Return signed distances (P,) from places (P, 3) along unit normals (P, 3) to the surface; infinite where none is within reach.

    The nearer of the first hits to both sides counts; the back of a surface is the other side of a thin part, and does not.
    """
    nearest = np.full(len(place), np.inf, np.float32)
    for side in (1, -1):
        hits = tracer.closest(place, side * normal)
        front = (hits.triangle >= 0) & (hits.distance <= reach)
        front[front] = (facing[hits.triangle[front]] * normal[front]).sum(-1) > 0
        nearer = front & (hits.distance < np.abs(nearest))
        nearest[nearer] = side * hits.distance[nearer]
    return nearest
