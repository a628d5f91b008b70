# SPDX-License-Identifier: GPL-3.0-or-later
"""From the bare surface to a textured mesh: unwrap, gather materials from the views, bake."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from ..errors import Cancelled
from ..progress.protocol import Progress
from ..scene.gbuffer import GBuffer, SurfaceSamples
from ..scene.mesh import Mesh
from ..scene.surface import Surface
from ..settings.schema import SurfaceSettings
from . import meshing
from .bake import colour_byte, detailed, rasterise, tangent_space, tangents, to_byte
from .material_fusion import fuse_attributes
from .meshing import Triangles
from .unwrap import unwrap


def textured_mesh(
    surface: Surface, views: Sequence[GBuffer], samples: SurfaceSamples, settings: SurfaceSettings, progress: Progress
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
    fused = fuse_attributes(surface.vertices, surface.normals, views, samples, surface.voxel, stoppable(progress))
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
    mesh.textures.update(baked_textures(mesh, views, samples, surface.voxel, settings, stoppable(progress, len(views))))
    return mesh


def stoppable(progress: Progress, before: int = 0) -> Callable[[int], None]:
    """Tells how many steps of a phase are done, those `before` included; raises Cancelled where the user stopped the work."""

    def step(done: int) -> None:
        progress.step(before + done)
        if progress.cancelled:
            raise Cancelled("stopped while materials were being baked")

    return step


def painted_mesh(
    vertices: np.ndarray,
    normals: np.ndarray,
    uvs: np.ndarray,
    faces: np.ndarray,
    views: Sequence[GBuffer],
    samples: SurfaceSamples,
    voxel: float,
    settings: SurfaceSettings,
    progress: Progress,
) -> Mesh:
    """A mesh that is all there (shapes as in `Mesh`) with materials at its vertices and in textures; geometry and UVs stay as they are.

    Args:
        voxel: resolution of the surface that the views agree on, world units: how far from it the mesh may lie and still be seen.
    """
    progress.phase("bake", 2 * len(views))
    fused = fuse_attributes(vertices, normals, views, samples, voxel, stoppable(progress))
    mesh = Mesh(
        vertices=vertices.astype(np.float32),
        normals=normals.astype(np.float32),
        uvs=uvs,
        faces=faces.astype(np.int32),
        albedo=fused.albedo,
        roughness=fused.roughness,
        metallic=fused.metallic,
    )
    mesh.textures.update(baked_textures(mesh, views, samples, voxel, settings, stoppable(progress, len(views))))
    return mesh


def baked_textures(
    mesh: Mesh,
    views: Sequence[GBuffer],
    samples: SurfaceSamples,
    voxel: float,
    settings: SurfaceSettings,
    step: Callable[[int], None] = lambda done: None,
) -> dict[str, np.ndarray]:
    """`Mesh.textures` for a mesh with UVs and normals; `step` is told the number of views done."""
    texels = rasterise(mesh.uvs, mesh.faces, settings.texture)
    frames = tangents(mesh.vertices, mesh.normals, mesh.uvs, mesh.faces)
    points = texels.interpolate(mesh.vertices, mesh.faces)
    normal = meshing.unit(texels.interpolate(mesh.normals, mesh.faces))
    fused = fuse_attributes(points, normal, views, samples, voxel, step)
    side = frames[mesh.faces[texels.face, 0], 3]
    tangent = texels.interpolate(frames[:, :3], mesh.faces)
    tangent = meshing.unit(tangent - (tangent * normal).sum(-1, keepdims=True) * normal)
    seen = fused.weight > 0
    detail = np.where(seen[:, None], detailed(normal, fused.normal, seen, settings.detail), normal)
    local = tangent_space(detail, normal, tangent, side)
    return {
        "albedo": texels.image(colour_byte(fused.albedo)),
        "roughness": texels.image(to_byte(fused.roughness)),
        "metallic": texels.image(to_byte(fused.metallic)),
        "normal": texels.image(to_byte(0.5 + 0.5 * local)),
    }
