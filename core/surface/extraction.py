# SPDX-License-Identifier: GPL-3.0-or-later
"""Surface extraction from rendered depth: TSDF fusion, marching cubes, smoothing, decimation, offset to the silhouettes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ..errors import Cancelled, IrgsppError
from ..progress.protocol import Progress
from ..scene.camera import Camera
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
        bound: sphere around the object; everything outside it and below its floor is ignored.
        settings: resolution, smoothing and triangle budget.
        progress: receives steps and messages, and may cancel.
        masks: (H, W) opacity of each view's image; where given, the surface is moved outward at its outlines to fill them.

    Raises:
        IrgsppError: no surface was found.
        Cancelled: the user stopped the work.
    """
    return extract_levels(views, samples, bound, settings, progress, masks, (settings.triangles,))[0]


def extract_levels(
    views: Sequence[GBuffer],
    samples: SurfaceSamples,
    bound: Bound,
    settings: SurfaceSettings,
    progress: Progress,
    masks: Sequence[np.ndarray] | None,
    budgets: Sequence[int | None],
) -> list[Surface]:
    """Extract the object's surface at several triangle budgets from one fusion.

    Args:
        views: as in `extract_geometry`, like the following.
        samples: Gaussians.
        bound: sphere around the object.
        settings: resolution and smoothing.
        progress: receives steps and messages, and may cancel.
        masks: opacity of each view's image, or None.
        budgets: largest number of triangles of each surface; None for the surface as it is fused, neither decimated nor repaired.

    Raises:
        IrgsppError: no surface was found.
        Cancelled: the user stopped the work.
    """
    progress.phase("fuse", len(views))
    grid = make_grid(views, samples, bound, settings)
    fused = _fused_surface(fuse(views, grid, progress, bound.floor), grid, settings)
    surfaces = []
    for budget in budgets:
        surface = fused.surface() if budget is None else _reduced(fused, budget, settings)
        surface = _filling(surface, [view.camera for view in views], masks, progress)
        surface = surface if budget is None else _unfold(surface)
        progress.message(f"surface: {len(surface.vertices):,} vertices, {len(surface.faces):,} triangles")
        if progress.cancelled:
            raise Cancelled("stopped during surface extraction")
        surfaces.append(surface)
    return surfaces


def _filling(surface: Surface, cameras: Sequence[Camera], masks: Sequence[np.ndarray] | None, progress: Progress) -> Surface:
    """Return the surface moved outward at its outlines to fill the masks, where there are some."""
    if masks is not None:
        offset = silhouette_offset(surface.vertices, surface.faces, cameras, masks)
        surface = Surface(surface.vertices + offset[:, None] * surface.normals, surface.normals, surface.faces, surface.voxel)
        progress.message(f"surface moved outward by {offset.mean():.2g} scene units on average to fill the masks")
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


@dataclass(frozen=True, eq=False)
class _Fused:
    """Surface as it is fused and smoothed, before decimation.

    Attributes:
        mesh: its triangles.
        normals: (V, 3) unit vertex normals.
        voxel: side of a cell of the grid, world units.
        longest: length of the longest open border that counts as a hole, world units.
    """

    mesh: meshing.Triangles
    normals: np.ndarray
    voxel: float
    longest: float

    def surface(self) -> Surface:
        """Return it as a surface."""
        return Surface(self.mesh.vertices, self.normals, self.mesh.faces, self.voxel)


def _fused_surface(distance: np.ndarray, grid: Grid, settings: SurfaceSettings) -> _Fused:
    """Mesh distances (B, BLOCK^3), fill holes, and smooth."""
    fine = meshing.main_components(meshing.cleaned(meshing.isosurface(distance, grid)), settings.fragment)
    if not len(fine.faces):
        raise IrgsppError("no surface: the largest one that the views' depths agree on is too small for an object")
    longest = _longest_hole(fine.vertices)
    fine = meshing.smoothed(repair.fill_holes(fine, longest), settings.smoothing)
    return _Fused(fine, meshing.vertex_normals(fine, settings.normal_averages), grid.voxel, longest)


def _longest_hole(vertices: np.ndarray) -> float:
    """Return the length of the longest open border that counts as a hole of a surface with vertices (V, 3), world units."""
    return MAX_HOLE_DIAMETERS * float(np.linalg.norm(np.ptp(vertices, axis=0)))


def _reduced(fused: _Fused, triangles: int, settings: SurfaceSettings) -> Surface:
    """Return the surface decimated to a budget, with unit vertex normals that the fused one supplies."""
    mesh = meshing.decimated(fused.mesh, int(DECIMATED_FRACTION * triangles))
    mesh = repair.fill_holes(repair.make_manifold(meshing.cleaned(mesh)), fused.longest)
    mesh = repair.remove_folds(mesh, fused.longest)
    mesh = meshing.main_components(mesh, settings.fragment)  # dividing what only touches can leave a crumb
    return Surface(mesh.vertices, meshing.carried_normals(fused.mesh, fused.normals, mesh), mesh.faces, fused.voxel)


def _unfold(surface: Surface) -> Surface:
    """Return the surface without folded faces, and with normals that face them."""
    moved = meshing.Triangles(surface.vertices, surface.faces)
    mesh = repair.remove_folds(moved, _longest_hole(moved.vertices))
    normals = surface.normals
    if mesh.faces is not moved.faces:  # an edge was collapsed; the number of vertices may be as before
        normals = meshing.carried_normals(moved, normals, mesh)
    return Surface(mesh.vertices, repair.facing_normals(mesh, normals), mesh.faces, surface.voxel)
