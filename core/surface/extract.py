# SPDX-License-Identifier: GPL-3.0-or-later
"""From rendered views to a textured mesh: fuse, mesh, unwrap, bake."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ..config import SurfaceSettings
from ..datasets.dataset import Bound
from ..errors import Cancelled, IrgsppError
from ..progress import Progress
from ..scene.buffers import SurfaceSamples, ViewBuffers
from ..scene.mesh import Mesh
from . import meshing
from .attributes import fuse_attributes
from .bake import colour_byte, detailed, rasterise, tangent_space, tangents, to_byte
from .fusion import fuse
from .grid import Grid, make_grid
from .meshing import Triangles
from .silhouette import silhouette_offset
from .unwrap import unwrap


def extract_surface(
    views: Sequence[ViewBuffers],
    samples: SurfaceSamples,
    bound: Bound,
    settings: SurfaceSettings,
    progress: Progress,
    masks: Sequence[np.ndarray] | None = None,
) -> Mesh:
    """The object's surface as a mesh with materials at the vertices and in textures.

    Args:
        views: what the training cameras see of the reconstruction.
        samples: its Gaussians, asked where no view sees the surface.
        bound: the object; what lies outside is left out.
        masks: (H, W) opacity of each view's photograph, where known: the surface is moved out to fill them.

    Raises:
        IrgsppError: no surface was found. Cancelled: the user stopped the work.
    """
    progress.phase("fuse", len(views))
    grid = make_grid(views, samples, bound, settings.voxels)
    surface, normals = _surface(fuse(views, grid, progress), grid, settings)
    if masks is not None:
        offset = silhouette_offset(surface.vertices, surface.faces, [view.camera for view in views], masks)
        surface = meshing.Triangles(surface.vertices + offset * normals, surface.faces)
        progress.message(f"surface moved out by {offset:.2g} to fill the masks")
    progress.message(f"surface: {len(surface.vertices):,} vertices, {len(surface.faces):,} triangles")
    _stop_if_asked(progress)
    progress.phase("unwrap", 1)
    source, faces, uvs = unwrap(surface, settings.texture)
    progress.step(1)
    _stop_if_asked(progress)
    progress.phase("bake", 2 * len(views))
    fused = fuse_attributes(surface.vertices, normals, views, samples, grid.voxel, progress.step)
    normals = detailed(normals, fused.normal, fused.weight > 0, settings.detail)
    mesh = Mesh(
        vertices=surface.vertices[source].astype(np.float32),
        normals=normals[source].astype(np.float32),
        uvs=uvs,
        faces=faces,
        albedo=fused.albedo[source],
        roughness=fused.roughness[source],
        metallic=fused.metallic[source],
    )
    mesh.textures.update(_textures(mesh, views, samples, grid.voxel, settings, progress))
    return mesh


def _surface(distance: np.ndarray, grid: Grid, settings: SurfaceSettings) -> tuple[Triangles, np.ndarray]:
    """The mesh within its budget, and unit normals of its vertices."""
    fine = meshing.main_components(meshing.cleaned(meshing.isosurface(distance, grid)), settings.fragment)
    if not len(fine.faces):
        raise IrgsppError("no surface: what the views' depths agree on is too small to be an object")
    fine = meshing.smoothed(fine, settings.smoothing)
    normals = meshing.vertex_normals(fine, settings.normal_averages)
    mesh = meshing.cleaned(meshing.decimated(fine, settings.triangles))
    return mesh, meshing.carried_normals(fine, normals, mesh.vertices)


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


def _stop_if_asked(progress: Progress) -> None:
    if progress.cancelled:
        raise Cancelled("stopped while the surface was being made")
