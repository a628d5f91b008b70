# SPDX-License-Identifier: GPL-3.0-or-later
"""Final mesh of a reconstruction: triangles with materials and textures."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np


@dataclass(frozen=True, eq=False)
class Mesh:
    """Triangle mesh in the world, with vertices split along UV seams.

    Attributes:
        vertices: (V, 3) float32.
        normals: (V, 3) float32 unit, equal on both sides of a seam.
        uvs: (V, 2) float32 in 0..1, v = 0 at the bottom of the image (Blender, glTF flips it).
        faces: (F, 3) int32, counter-clockwise seen from outside.
        albedo: (V, 3) float32 linear 0..1; roughness, metallic: (V,) float32 in 0..1.
        textures: "albedo" (T, T, 3) sRGB, "roughness" and "metallic" (T, T), "normal" (T, T, 3) tangent-space (OpenGL, +Y up), these
            uint8 or uint16; "confidence" (T, T) and "material_confidence" (T, T, 3) uint8, "height" (T, T) uint16, see `HeightMap`;
            row 0 is the top of the image. Empty where nothing was baked.
        confidence: (V,) float32, 0 where no view sees the vertex, 0.5 for one view straight at it, towards 1 with their number; or None
            where it is not known.
        material_confidence: (V, 3) float32 of albedo, roughness and metallic, in 0..1, see `Reconstruction`; 0 where no view sees the
            vertex; or None where it is not known.
        quads: (F,) bool, True for a triangle (a, b, c) that makes up the quad (a, b, c, d) with the next one, (a, c, d); or None
            where all faces are triangles.
    """

    vertices: np.ndarray
    normals: np.ndarray
    uvs: np.ndarray
    faces: np.ndarray
    albedo: np.ndarray
    roughness: np.ndarray
    metallic: np.ndarray
    textures: dict[str, np.ndarray] = field(default_factory=dict)
    confidence: np.ndarray | None = None
    material_confidence: np.ndarray | None = None
    quads: np.ndarray | None = None


def foot(vertices: np.ndarray) -> np.ndarray:
    """Return the middle of the lower side of the bounding box of vertices (V, 3), (3,): where the object stands."""
    low, high = vertices.min(0).astype(np.float64), vertices.max(0).astype(np.float64)
    return np.array([*(low + high)[:2] / 2, low[2]])


def standing(vertices: np.ndarray, transform: np.ndarray) -> np.ndarray:
    """Return the matrix (4, 4) of a linear transform (3, 3) followed by the move of the foot of vertices (V, 3) to the origin."""
    matrix = np.eye(4)
    matrix[:3, :3] = transform
    matrix[:3, 3] = -foot(vertices.astype(np.float64) @ transform.T)
    return matrix


def placed_mesh(mesh: Mesh, matrix: np.ndarray) -> Mesh:
    """Return a mesh after an affine map (4, 4) that does not mirror."""
    normals = mesh.normals @ np.linalg.inv(matrix[:3, :3])
    normals /= np.maximum(np.linalg.norm(normals, axis=-1, keepdims=True), 1e-12)
    vertices = mesh.vertices @ matrix[:3, :3].T + matrix[:3, 3]
    return replace(mesh, vertices=vertices.astype(np.float32), normals=normals.astype(np.float32))


def joined_quads(faces: np.ndarray, quads: np.ndarray | None) -> np.ndarray | None:
    """Return which quads are still whole after faces or vertices have changed, such as where a UV seam runs along a diagonal.

    Args:
        faces: (F, 3).
        quads: (F,) bool as in `Mesh.quads`, or None.

    Returns:
        (F,) bool, True where the triangles share the diagonal's vertices; None where there is no quad.
    """
    if quads is None or not quads.any():
        return None
    following = np.roll(faces, -1, axis=0)
    whole = quads & ~np.roll(quads, -1) & (faces[:, 0] == following[:, 0]) & (faces[:, 2] == following[:, 1])
    whole[-1] = False
    return whole if whole.any() else None
