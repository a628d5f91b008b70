# SPDX-License-Identifier: GPL-3.0-or-later
"""Ambient occlusion of a mesh as a texture, traced by Embree."""

from __future__ import annotations

import cv2
import numpy as np
import torch

from ..scene.mesh import Mesh
from ..scene.triangle_tracer import TriangleTracer
from ..shading.sampling import cosine_directions
from ..surface.mesh_texels import MeshTexels, mesh_texels
from ..surface.meshing import unit

RAYS = 64  # from each texel
SIZE = 512  # texels along a side that are traced, at most: occlusion changes slowly
CHUNK = 1 << 14  # texels whose rays are traced at a time
ABOVE = 2e-3  # distance above the surface at which rays start, as a fraction of the mesh's diagonal
REACH = 0.5  # length of a ray, as a fraction of the diagonal


def occlusion_texture(mesh: Mesh, size: int) -> np.ndarray:
    """Trace the cosine-weighted fraction of the directions from each texel in which no part of the mesh is near.

    Args:
        mesh: with UVs.
        size: texels along a side of the texture.

    Returns:
        (size, size) float32 in 0..1, 1 where nothing occludes.
    """
    texels = mesh_texels(mesh.vertices, mesh.uvs, mesh.faces, min(size, SIZE))
    traced = texels.image(_visibility(mesh, texels))
    smooth = cv2.bilateralFilter(traced, 5, 0.25, 1.5)  # of the noise of few rays
    return np.clip(cv2.resize(smooth, (size, size), interpolation=cv2.INTER_LINEAR), 0, 1)


def _visibility(mesh: Mesh, texels: MeshTexels) -> np.ndarray:
    """Return the visibility (P,) float32 of the texels."""
    tracer = TriangleTracer(mesh.vertices[mesh.faces])
    diagonal = float(np.linalg.norm(np.ptp(mesh.vertices, axis=0)))
    random = np.random.default_rng(0)
    seen = np.empty(len(texels.index), np.float32)
    for begin in range(0, len(seen), CHUNK):
        part = slice(begin, begin + CHUNK)
        normal = unit(texels.interpolate(mesh.normals, mesh.faces, part))
        origin = texels.interpolate(mesh.vertices, mesh.faces, part) + ABOVE * diagonal * normal
        shift = torch.from_numpy(random.random((len(normal), 2), np.float32))
        direction = cosine_directions(torch.from_numpy(normal.astype(np.float32)), RAYS, shift).reshape(-1, 3).numpy()
        rays = np.repeat(origin, RAYS, 0).astype(np.float32), direction
        hit = tracer.meet(*rays, np.full(len(direction), REACH * diagonal, np.float32))
        seen[part] = 1 - hit.reshape(-1, RAYS).mean(1)
    return seen
