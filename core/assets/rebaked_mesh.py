# SPDX-License-Identifier: GPL-3.0-or-later
"""Mesh of a finished run with textures baked again: the run's own, a new one, or an edited one."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ..errors import InputError
from ..io.run_files import FINE_SURFACE
from ..io.run_json import udim_tiles
from ..progress.protocol import Progress
from ..rendering.gbuffer_cache import GBufferCache
from ..rendering.trusted_device import trusted_device
from ..scene.camera_files import load_run_cameras
from ..scene.edited_mesh import EditedMesh, load_edited_mesh
from ..scene.mesh import Mesh, joined_quads
from ..scene.mesh_ply import load_mesh_ply
from ..scene.reconstruction import Reconstruction
from ..scene.surface import Surface
from ..settings.schema import SurfaceSettings
from ..surface.extraction import extract_levels
from ..surface.height import HeightMap, height_map
from ..surface.meshing import Triangles, vertex_normals
from ..surface.normal_source import NormalSource, run_normal_source
from ..surface.texturing import baked_textures, mesh_with_materials, stoppable, textured_mesh
from ..surface.tile_packing import packed_in_tiles
from ..surface.unwrap import PADDING, unwrapped_again
from ..surface.voxel_grid import make_grid
from .bake_target import BakeTarget
from .quad_mesh import quad_mesh


@dataclass(frozen=True, eq=False)
class Rebaked:
    """Mesh that was baked again.

    Attributes:
        mesh: with its textures, among them "height" where there are heights.
        reconstruction: of the run.
        heights: None where they were not asked for, or the mesh is not reduced.
    """

    mesh: Mesh
    reconstruction: Reconstruction
    heights: HeightMap | None


def rebaked_mesh(run: Path, settings: SurfaceSettings, target: BakeTarget, progress: Progress) -> Rebaked:
    """Bake the textures of a run again.

    Args:
        run: folder of the finished run.
        settings: of the surface and its textures.
        target: mesh to bake onto.
        progress: receives steps and messages, and may cancel.

    Raises:
        InputError: if a file can't be read, the edited mesh lies elsewhere, or the number of quads is too small.
        Cancelled: the user stopped the work.
        NoBlender: when quads are asked for and no Blender is found.
        IrgsppError: when Blender fails.
    """
    given = _packed(quad_mesh(run, target.quads, progress), settings) if target.quads is not None else None
    given = load_edited_mesh(target.edited) if target.edited else given
    reconstruction = Reconstruction.load(run).to(trusted_device().device)
    if given is not None and target.edited is not None:
        _check_place(given, reconstruction, target.edited)
    cameras = [placed.camera for placed in load_run_cameras(run / "cameras.json") if placed.split == "train"]
    views = GBufferCache(reconstruction, cameras)
    fused_needed = target.height or not (run / FINE_SURFACE).is_file()
    surface, fused = _surfaces(reconstruction, views, settings, target.triangles, fused_needed, progress)
    normal_source = run_normal_source(run, settings.detail, cameras, fused)
    mesh = _baked(run, given or surface, reconstruction, views, settings, normal_source, progress)
    heights = height_map(mesh, fused, settings.texels) if target.height and fused is not None else None
    if heights is not None:
        mesh = dataclasses.replace(mesh, textures={**mesh.textures, "height": heights.image})
    return Rebaked(mesh, reconstruction, heights)


def _packed(mesh: EditedMesh, settings: SurfaceSettings) -> EditedMesh:
    """Return a mesh with its charts packed into the UDIM tiles that are set."""
    if settings.udim_tiles == 1 or mesh.uvs is None:
        return mesh
    source, faces, uvs = packed_in_tiles(mesh.faces, mesh.uvs, settings.udim_tiles, settings.texels, PADDING, mesh.quads)
    normals = None if mesh.normals is None else mesh.normals[source]
    return EditedMesh(mesh.vertices[source], faces.astype(np.int64), uvs, normals, joined_quads(faces, mesh.quads), settings.udim_tiles)


def _surfaces(
    reconstruction: Reconstruction, views: GBufferCache, settings: SurfaceSettings, triangles: int | None, fused: bool, progress: Progress
) -> tuple[Surface | None, Surface | None]:
    """Return a new surface of at most so many triangles, and if `fused` the surface as it is fused; None for what is not needed."""
    budgets = ([] if triangles is None else [triangles]) + ([None] if fused else [])
    if not budgets:
        return None, None
    # The masks themselves may be gone; the Gaussians were fitted to them.
    masks = [view.alpha for view in views] if reconstruction.background is None else None
    found = extract_levels(views, reconstruction.surface_samples(), reconstruction.bound, settings, progress, masks, budgets)
    return found[0] if triangles is not None else None, found[-1] if fused else None


def _baked(
    run: Path,
    given: EditedMesh | Surface | None,
    reconstruction: Reconstruction,
    views: GBufferCache,
    settings: SurfaceSettings,
    normal_source: NormalSource,
    progress: Progress,
) -> Mesh:
    """Return the edited mesh or the new surface, else the run's own mesh, with textures."""
    samples = reconstruction.surface_samples()
    if isinstance(given, Surface):
        return textured_mesh(given, views, samples, settings, progress, normal_source=normal_source)
    voxel = make_grid(views, samples, reconstruction.bound, settings).voxel
    if given is not None:
        normals = vertex_normals(Triangles(given.vertices, given.faces)) if given.normals is None else given.normals
        edited = Surface(given.vertices, normals, given.faces, voxel)
        if given.uvs is None:
            mesh = textured_mesh(edited, views, samples, settings, progress, normal_source=normal_source)
        else:
            mesh = mesh_with_materials(edited, given.uvs, views, samples, settings, progress, normal_source)
        return dataclasses.replace(mesh, quads=joined_quads(mesh.faces, given.quads))
    mesh = load_mesh_ply(run / "mesh.ply")
    if settings.udim_tiles != udim_tiles(run):
        progress.phase("unwrap", 0)
        mesh = unwrapped_again(mesh, settings.texels, settings.udim_tiles)
    progress.phase("bake", len(views))
    return dataclasses.replace(mesh, textures=baked_textures(mesh, views, samples, voxel, settings, stoppable(progress), normal_source))


def _check_place(mesh: EditedMesh, reconstruction: Reconstruction, path: Path) -> None:
    """Refuse a mesh in another frame, whose textures would show the wrong parts of the object."""
    bound = reconstruction.bound
    distance = np.linalg.norm(mesh.vertices - np.asarray(bound.centre), axis=-1)
    if np.median(distance) > 1.5 * bound.radius or distance.max() < 0.01 * bound.radius:
        raise InputError(path, "doesn't lie where the run's object is", "export it in the frame of the run's mesh.ply (+Z up, unscaled)")
