# SPDX-License-Identifier: GPL-3.0-or-later
"""From rendered depth to the bare surface: fuse, mesh, smooth, decimate, move out to the silhouettes."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ..errors import Cancelled, IrgsppError
from ..progress.protocol import Progress
from ..scene.dataset import Bound
from ..scene.gbuffer import GBuffer, SurfaceSamples
from ..scene.surface import Surface
from ..settings.schema import SurfaceSettings
from . import meshing
from .fusion import fuse
from .silhouette import silhouette_offset
from .voxel_grid import Grid, make_grid


def extract_geometry(
    views: Sequence[GBuffer],
    samples: SurfaceSamples,
    bound: Bound,
    settings: SurfaceSettings,
    progress: Progress,
    masks: Sequence[np.ndarray] | None = None,
) -> Surface:
    """The object's surface.

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
    surface = _surface(fuse(views, grid, progress), grid, settings)
    if masks is not None:
        offset = silhouette_offset(surface.vertices, surface.faces, [view.camera for view in views], masks)
        surface = Surface(surface.vertices + offset * surface.normals, surface.normals, surface.faces, surface.voxel)
        progress.message(f"surface moved out by {offset:.2g} to fill the masks")
    progress.message(f"surface: {len(surface.vertices):,} vertices, {len(surface.faces):,} triangles")
    if progress.cancelled:
        raise Cancelled("stopped while the surface was being made")
    return surface


def _surface(distance: np.ndarray, grid: Grid, settings: SurfaceSettings) -> Surface:
    """The mesh within its budget, and unit normals of its vertices."""
    fine = meshing.main_components(meshing.cleaned(meshing.isosurface(distance, grid)), settings.fragment)
    if not len(fine.faces):
        raise IrgsppError("no surface: what the views' depths agree on is too small to be an object")
    fine = meshing.smoothed(fine, settings.smoothing)
    normals = meshing.vertex_normals(fine, settings.normal_averages)
    mesh = meshing.cleaned(meshing.decimated(fine, settings.triangles))
    return Surface(mesh.vertices, meshing.carried_normals(fine, normals, mesh.vertices), mesh.faces, grid.voxel)
