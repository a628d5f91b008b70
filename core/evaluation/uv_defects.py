# SPDX-License-Identifier: GPL-3.0-or-later
"""Defects of a mesh's UVs: charts that overlap or leave the texture, faces without area in it, mirrored faces, texel density."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..scene.mesh import Mesh
from ..surface import topology
from ..surface.uv_overlap import GRID, UNMAPPED, covering_faces

QUANTILES = (0.05, 0.5, 0.95)  # of the texel density, over the surface's area


@dataclass(frozen=True)
class UvLayout:
    """Measures of a mesh's UVs.

    Attributes:
        charts: connected parts in the texture.
        covered: fraction of the texture that faces cover.
        overlap: fraction of the covered area that two or more faces cover.
        outside: vertices outside 0..1.
        unmapped: faces without area in the texture.
        mirrored: faces that are mirrored in the texture.
        density: 5 %, median and 95 % quantile of the texels per world unit.
    """

    charts: int
    covered: float
    overlap: float
    outside: int
    unmapped: int
    mirrored: int
    density: tuple[float, float, float]


def uv_layout_of(mesh: Mesh, texture: int) -> UvLayout:
    """Measure the UVs of a mesh with at least one face.

    Args:
        mesh: the mesh.
        texture: texels along a side of its textures.
    """
    uv = mesh.uvs[mesh.faces].astype(np.float64)
    first, second = uv[:, 1] - uv[:, 0], uv[:, 2] - uv[:, 0]
    signed = (first[:, 0] * second[:, 1] - first[:, 1] * second[:, 0]) / 2
    least = UNMAPPED / 1024**2
    corner = mesh.vertices[mesh.faces].astype(np.float64)
    area = np.linalg.norm(np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0]), axis=-1) / 2
    cells = np.bincount(covering_faces(mesh.uvs, mesh.faces).reshape(-1), minlength=2)
    used = int(cells[1:].sum())
    return UvLayout(
        charts=int(topology.face_components(mesh.faces, topology.edges_of(mesh.faces)).max()) + 1,
        covered=used / GRID**2,
        overlap=float(cells[2:].sum() / max(used, 1)),
        outside=int(((mesh.uvs < 0) | (mesh.uvs > 1)).any(-1).sum()),
        unmapped=int((np.abs(signed) < least).sum()),
        mirrored=int((signed <= -least).sum()),
        density=_quantiles(texture * np.sqrt(np.abs(signed) / np.maximum(area, 1e-300)), area),
    )


def _quantiles(values: np.ndarray, weights: np.ndarray) -> tuple[float, float, float]:
    """Return the QUANTILES of values (F,) with weights (F,)."""
    order = np.argsort(values)
    total = np.cumsum(weights[order])
    places = np.searchsorted(total, np.array(QUANTILES) * total[-1]).clip(max=len(values) - 1)
    low, median, high = (float(x) for x in values[order][places])
    return low, median, high
