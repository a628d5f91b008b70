# SPDX-License-Identifier: GPL-3.0-or-later
"""Final mesh of a reconstruction: triangles with materials and textures."""

from __future__ import annotations

from dataclasses import dataclass, field

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
