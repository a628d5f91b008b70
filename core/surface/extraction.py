# SPDX-License-Identifier: GPL-3.0-or-later
"""Surface extraction from rendered depth: TSDF fusion, marching cubes, smoothing, decimation, offset to the silhouettes."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ..errors import Cancelled, IrgsppError
from ..progress.protocol import Progress
from ..scene.dataset import Bound
from ..scene.gbuffer import GBuffer, SurfaceSamples
from ..scene.surface import Surface
from ..settings.schema import SurfaceSettings
from . import meshing, repair
from .fusion import fuse
from .silhouette import silhouette_offset
from .voxel_grid import Grid, make_grid

DECIMATED_FRACTION = 0.99  # of the triangle budget: repair adds a few
MAX_HOLE_DIAMETERS = 1.0  # diameters of the object: a shorter open border is a hole and is filled, a longer one is the end of the surface


def extract_geometry(
    views: Sequence[GBuffer],
    samples: SurfaceSamples,
    bound: Bound,
    settings: SurfaceSettings,
    progress: Progress,
    masks: Sequence[np.ndarray] | None = None,
) -> Surface:
    """Extract the object's surface.

    Args:
        views: G-buffers of the reconstruction at the training cameras.
        samples: its Gaussians; they mark space near the surface that no view sees.
        bound: sphere around the object; everything outside is ignored.
        settings: resolution, smoothing and triangle budget.
        progress: receives steps and messages, and may cancel.
        masks: (H, W) opacity of each view's image; where given, the surface is moved outward at its outlines to fill them.

    Raises:
        IrgsppError: no surface was found.
        Cancelled: the user stopped the work.
    """
    progress.phase("fuse", len(views))
    grid = make_grid(views, samples, bound, settings)
    surface = _surface(fuse(views, grid, progress), grid, settings)
    if masks is not None:
        offset = silhouette_offset(surface.vertices, surface.faces, [view.camera for view in views], masks)
        surface = Surface(surface.vertices + offset[:, None] * surface.normals, surface.normals, surface.faces, surface.voxel)
        progress.message(f"surface moved outward by {offset.mean():.2g} scene units on average to fill the masks")
    surface = _unfold(surface)
    progress.message(f"surface: {len(surface.vertices):,} vertices, {len(surface.faces):,} triangles")
    if progress.cancelled:
        raise Cancelled("stopped during surface extraction")
    return surface


def coarser(surface: Surface, triangles: int) -> Surface:
    """Decimate a surface; its vertex normals are interpolated from those of the fine one.

    Decimation can leave folds and edges of more than two faces: the result serves to draw points, not as an asset.

    Args:
        surface: surface to decimate; it is returned itself where it is small enough.
        triangles: approximate number of triangles of the result, at most.
    """
    if len(surface.faces) <= triangles:
        return surface
    fine = meshing.Triangles(surface.vertices, surface.faces)
    mesh = meshing.compacted(meshing.decimated(fine, triangles))
    return Surface(mesh.vertices, meshing.carried_normals(fine, surface.normals, mesh), mesh.faces, surface.voxel)


def _surface(distance: np.ndarray, grid: Grid, settings: SurfaceSettings) -> Surface:
    """Mesh distances (B, BLOCK^3) within the triangle budget, with unit vertex normals that a finer mesh supplies."""
    fine = meshing.main_components(meshing.cleaned(meshing.isosurface(distance, grid)), settings.fragment)
    if not len(fine.faces):
        raise IrgsppError("no surface: the largest one that the views' depths agree on is too small for an object")
    longest = MAX_HOLE_DIAMETERS * float(np.linalg.norm(np.ptp(fine.vertices, axis=0)))
    fine = repair.fill_holes(fine, longest)
    fine = meshing.smoothed(fine, settings.smoothing)
    normals = meshing.vertex_normals(fine, settings.normal_averages)
    mesh = repair.make_manifold(meshing.cleaned(meshing.decimated(fine, int(DECIMATED_FRACTION * settings.triangles))))
    mesh = repair.fill_holes(repair.remove_folds(mesh), longest)  # where three sheets meet, a division leaves a hole
    mesh = meshing.main_components(mesh, settings.fragment)  # dividing what only touches can leave a crumb
    return Surface(mesh.vertices, meshing.carried_normals(fine, normals, mesh), mesh.faces, grid.voxel)


def _unfold(surface: Surface) -> Surface:
    """Return the surface without folded faces, and with normals that face them."""
    moved = meshing.Triangles(surface.vertices, surface.faces)
    mesh = repair.remove_folds(moved)
    normals = surface.normals
    if len(mesh.vertices) != len(moved.vertices):  # an edge was collapsed
        normals = meshing.carried_normals(moved, normals, mesh)
    return Surface(mesh.vertices, repair.facing_normals(mesh, normals), mesh.faces, surface.voxel)
