# SPDX-License-Identifier: GPL-3.0-or-later
"""From the bare surface to a textured mesh: unwrap, gather materials from the views, bake."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ..config import SurfaceSettings
from ..errors import Cancelled
from ..progress import Progress
from ..scene.buffers import SurfaceSamples, ViewBuffers
from ..scene.mesh import Mesh
from ..scene.surface import Surface
from . import meshing
from .attributes import fuse_attributes
from .bake import colour_byte, detailed, rasterise, tangent_space, tangents, to_byte
from .meshing import Triangles
from .unwrap import unwrap


def textured_mesh(
    surface: Surface, views: Sequence[ViewBuffers], samples: SurfaceSamples, settings: SurfaceSettings, progress: Progress
) -> Mesh:
    """The surface as a mesh with materials at the vertices and in textures.

    Args:
        surface: where the mesh lies. views: what the training cameras see of the reconstruction.
        samples: its Gaussians, asked where no view sees the surface.

    Raises Cancelled where the user stopped the work.
    """
    progress.phase("unwrap", 1)
    source, faces, uvs = unwrap(Triangles(surface.vertices, surface.faces), settings.texture)
    progress.step(1)
    if progress.cancelled:
        raise Cancelled("stopped while the surface was being unwrapped")
    progress.phase("bake", 2 * len(views))
    fused = fuse_attributes(surface.vertices, surface.normals, views, samples, surface.voxel, progress.step)
    normals = detailed(surface.normals, fused.normal, fused.weight > 0, settings.detail)
    mesh = Mesh(
        vertices=surface.vertices[source].astype(np.float32),
        normals=normals[source].astype(np.float32),
        uvs=uvs,
        faces=faces,
        albedo=fused.albedo[source],
        roughness=fused.roughness[source],
        metallic=fused.metallic[source],
    )
    mesh.textures.update(_textures(mesh, views, samples, surface.voxel, settings, progress))
    return mesh


def _textures(
    mesh: Mesh, views: Sequence[ViewBuffers], samples: SurfaceSamples, voxel: float, settings: SurfaceSettings, progress: Progress
) -> dict[str, np.ndarray]:
    texels = rasterise(mesh.uvs, mesh.faces, settings.texture)
    frames = tangents(mesh.vertices, mesh.normals, mesh.uvs, mesh.faces)
    points = texels.interpolate(mesh.vertices, mesh.faces)
    normal = meshing.unit(texels.interpolate(mesh.normals, mesh.faces))
    fused = fuse_attributes(points, normal, views, samples, voxel, lambda done: progress.step(len(views) + done))
    side = frames[mesh.faces[texels.face, 0], 3]
    tangent = texels.interpolate(frames[:, :3], mesh.faces)
    tangent = meshing.unit(tangent - (tangent * normal).sum(-1, keepdims=True) * normal)
    seen = fused.weight > 0
    detail = np.where(seen[:, None], detailed(normal, fused.normal, seen, settings.detail), normal)
    local = tangent_space(detail, normal, tangent, side)
    return {
        "albedo": texels.picture(colour_byte(fused.albedo)),
        "roughness": texels.picture(to_byte(fused.roughness)),
        "metallic": texels.picture(to_byte(fused.metallic)),
        "normal": texels.picture(to_byte(0.5 + 0.5 * local)),
    }
