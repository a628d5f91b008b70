# SPDX-License-Identifier: GPL-3.0-or-later
"""Normals of a mesh and of its normal texture: from a fine surface and from the views, where these know more than the mesh."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from ..io.run_files import FINE_SURFACE
from ..scene.camera import Camera
from ..scene.surface import Surface
from ..scene.surface_ply import load_surface_ply
from .material_fusion import FusedMaterials
from .meshing import unit
from .nearest_hits import NearestTracer
from .voxel_grid import footprint

CHUNK = 1 << 20  # points whose normals are computed at a time
# Weight of the views' normals in the mean with those of the surface. The errors of both have little in common: a mean with
# equal weights errs as little as the better one or less on metal and four of five other scenes. On relief the views know more
# (igea_relief: the fused surface 5.3 degrees, the views 4.1, the mean 4.6), but there shading finds a fine surface.
VIEWS_WEIGHT = 0.5
REPEATED_WEIGHT = 0.3  # the same, without a fine surface: once at the vertices, and once more at the texels between them
# Pixels that the edges of a fine surface are long, at most, where its normals hold all that the views show. The views' normals are
# those of single surfels, noisier than the surface that shading was fitted on.
MAX_EDGE_PIXELS = 2.0


class NormalSource:
    """Source of normals, by default the mesh itself with detail of the views.

    Args:
        detail: fraction of the views' usual weight, 0..1.
        fine: surface whose normals replace those of the mesh; None for none.
        resolved: True where the fine surface holds all detail of the views, see `resolves`.
    """

    def __init__(self, detail: float, fine: Surface | None = None, resolved: bool = False) -> None:
        self._tracer = None if fine is None else NearestTracer(fine)
        usual = REPEATED_WEIGHT if fine is None else VIEWS_WEIGHT
        self._weight = 0.0 if fine is not None and resolved else detail * usual

    def normals(self, place: np.ndarray, normal: np.ndarray, fused: FusedMaterials) -> np.ndarray:
        """Return the unit normals (P, 3) float32 at points of a mesh.

        Args:
            place: (P, 3) world.
            normal: (P, 3) unit, of the mesh.
            fused: normals of the points, fused from the views.
        """
        result = np.array(normal, np.float32)
        for begin in range(0, len(place), CHUNK):
            part = slice(begin, begin + CHUNK)
            own = result[part] if self._tracer is None else self._tracer.normals(place[part], result[part])
            weight = self._weight * (fused.weight[part, None] > 0)
            result[part] = unit((1 - weight) * own + weight * fused.normal[part])
        return result


def run_normal_source(run: Path, detail: float, cameras: Sequence[Camera], fine: Surface | None = None) -> NormalSource:
    """Return the source of normals of a run: its fine surface, where the second stage found one.

    Args:
        run: run folder.
        detail: see `NormalSource`.
        cameras: training cameras.
        fine: surface that takes the place of a missing one; None for none.

    Raises:
        InputError: if the surface can't be read.
    """
    found = load_surface_ply(run / FINE_SURFACE)
    return NormalSource(detail, fine) if found is None else NormalSource(detail, found, resolves(found, cameras))


def resolves(fine: Surface, cameras: Sequence[Camera]) -> bool:
    """Return True where a surface's edges are as short as the photographs' pixels ask for, see MAX_EDGE_PIXELS.

    Args:
        fine: the surface.
        cameras: training cameras.
    """
    edge = math.sqrt(4 / math.sqrt(3) * float(fine.areas().mean()))  # of an equilateral triangle of the mean area
    return edge < MAX_EDGE_PIXELS * float(np.median([footprint(camera, fine.vertices) for camera in cameras]))
