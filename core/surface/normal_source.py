# SPDX-License-Identifier: GPL-3.0-or-later
"""Normals of a mesh and of its normal texture: from a fine surface and from the views, where these know more than the mesh."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from ..io.run_files import FINE_SURFACE
from ..scene.camera import Camera
from ..scene.gbuffer import GBuffer, SurfaceSamples
from ..scene.surface import Surface
from ..scene.surface_ply import load_surface_ply
from .bake import add_normal_detail, normal_noise
from .material_fusion import FusedMaterials, fuse_materials
from .nearest_hits import NearestTracer
from .voxel_grid import footprint

CHUNK = 1 << 20  # points whose normals are computed at a time
NOISE_POINTS = 20_000  # vertices that the noise of normals is measured at
# Pixels that the edges of a fine surface are long, at most, where its normals hold all that the views show. The views' normals are
# those of single surfels, noisier than the surface that shading was fitted on.
MAX_EDGE_PIXELS = 2.0


class NormalSource:
    """Source of normals, by default the mesh itself with detail of the views.

    Args:
        strength: factor of the detail, 0..1.
        fine: surface whose normals replace those of the mesh; None for none.
        resolved: True where the fine surface holds all detail of the views, see `resolves`.
        noise: largest noise of normals, see `surface_noise`; None for no limit.
    """

    def __init__(self, strength: float, fine: Surface | None = None, resolved: bool = False, noise: float | None = None) -> None:
        self._tracer = None if fine is None else NearestTracer(fine)
        self._strength, self._noise = 0.0 if fine is not None and resolved else strength, noise

    def normals(self, place: np.ndarray, normal: np.ndarray, fused: FusedMaterials) -> np.ndarray:
        """Return the unit normals (P, 3) float32 at points of a mesh.

        Args:
            place: (P, 3) world.
            normal: (P, 3) unit, of the mesh.
            fused: normals of the points, fused from the views.
        """
        parts = [slice(begin, begin + CHUNK) for begin in range(0, len(place), CHUNK)]
        result = np.array(normal, np.float32)
        if self._tracer is not None:
            for part in parts:
                result[part] = self._tracer.normals(place[part], result[part])
        if not self._strength:
            return result
        seen = fused.weight > 0
        noise = normal_noise(result, fused.normal, seen)
        noise = noise if self._noise is None else min(noise, self._noise)
        for part in parts:
            detailed = add_normal_detail(result[part].astype(np.float64), fused.normal[part], noise, self._strength)
            result[part] = np.where(seen[part, None], detailed, result[part])
        return result


def run_normal_source(run: Path, strength: float, cameras: Sequence[Camera], noise: float | None = None) -> NormalSource:
    """Return the source of normals of a run: its fine surface, where the second stage found one.

    Args:
        run: run folder.
        strength: see `NormalSource`, like the last.
        cameras: training cameras.
        noise: largest noise of normals; None for no limit.

    Raises:
        InputError: if the surface can't be read.
    """
    fine = load_surface_ply(run / FINE_SURFACE)
    return NormalSource(strength, fine, fine is not None and resolves(fine, cameras), noise)


def resolves(fine: Surface, cameras: Sequence[Camera]) -> bool:
    """Return True where a surface's edges are as short as the photographs' pixels ask for, see MAX_EDGE_PIXELS.

    Args:
        fine: the surface.
        cameras: training cameras.
    """
    edge = math.sqrt(4 / math.sqrt(3) * float(fine.areas().mean()))  # of an equilateral triangle of the mean area
    return edge < MAX_EDGE_PIXELS * float(np.median([footprint(camera, fine.vertices) for camera in cameras]))


def surface_noise(fine: Surface, views: Sequence[GBuffer], samples: SurfaceSamples) -> float:
    """Return the noise of normals on the surface before its triangles are reduced, see `normal_noise`.

    On a reduced mesh, the difference of its normals from the views' is shape that its faces have lost, which must not count as noise.

    Args:
        fine: surface as it is fused.
        views: G-buffers of the reconstruction at the training cameras.
        samples: its Gaussians, for parts that no view sees.
    """
    pick = np.random.default_rng(0).choice(len(fine.vertices), min(NOISE_POINTS, len(fine.vertices)), replace=False)
    fused = fuse_materials(fine.vertices[pick], fine.normals[pick], views, samples, fine.voxel, lambda done: None)
    return normal_noise(fine.normals[pick], fused.normal, fused.weight > 0)
