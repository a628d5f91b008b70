# SPDX-License-Identifier: GPL-3.0-or-later
"""Texels of a mesh in a compact form: 16 bytes for each, so that a texture of 4096 texels takes 200 MB."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..scene.mesh import Mesh
from ..surface.bake import barycentric, doubled_area, texel_owners

CHUNK = 1 << 20  # texels whose coordinates are computed at a time


@dataclass(frozen=True, eq=False)
class MeshTexels:
    """P texels whose centre lies in a triangle of a mesh.

    Attributes:
        size: texels along a side of the texture.
        index: (P,) int32 flat index in the image, ascending.
        face: (P,) int32 triangle.
        barycentric: (P, 2) float32 weights of its second and third corner.
        side: (F,) float32 side of a texel on each triangle, world units.
    """

    size: int
    index: np.ndarray
    face: np.ndarray
    barycentric: np.ndarray
    side: np.ndarray


def mesh_texels(mesh: Mesh, size: int) -> MeshTexels:
    """Find the texels of a mesh.

    Args:
        mesh: mesh with UVs.
        size: texels along a side of the texture.
    """
    corners, owner = texel_owners(mesh.uvs, mesh.faces, size)
    index = np.flatnonzero(owner.ravel() >= 0).astype(np.int32)
    face = owner.ravel()[index]
    weights = np.empty((len(index), 2), np.float32)
    for begin in range(0, len(index), CHUNK):
        part = slice(begin, begin + CHUNK)
        point = np.stack([index[part] % size + 0.5, index[part] // size + 0.5], -1)
        weights[part] = np.clip(barycentric(corners[mesh.faces[face[part]]], point)[:, 1:], 0, 1)
    world = mesh.vertices[mesh.faces].astype(np.float64)
    area = np.linalg.norm(np.cross(world[:, 1] - world[:, 0], world[:, 2] - world[:, 0]), axis=-1)
    flat = np.abs(doubled_area(corners[mesh.faces]))
    side = np.sqrt(area / np.maximum(flat, 1e-12)).astype(np.float32)
    return MeshTexels(size, index, face, weights, side)
