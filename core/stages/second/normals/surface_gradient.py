# SPDX-License-Identifier: GPL-3.0-or-later
"""Differential operators on a triangle mesh: gradient of values at vertices, differences along edges, averages over neighbours."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import sparse

from ....scene.surface import Surface
from ....surface.topology import edges_of, neighbour_average


@dataclass(frozen=True, eq=False)
class SurfaceGradient:
    """Operators on values at V vertices, in units of the mean length of an edge.

    Attributes:
        gradient: three (V, V) matrices, world x, y and z of the gradient of piecewise linear values, averaged by area at the vertices.
        difference: (E, V), first minus second end of each edge.
        edges: (E, 2) vertices.
        average: (V, V), mean of the neighbours.
        length: mean length of an edge, world units.
    """

    gradient: tuple[sparse.csr_matrix, sparse.csr_matrix, sparse.csr_matrix]
    difference: sparse.csr_matrix
    edges: np.ndarray
    average: sparse.csr_matrix
    length: float

    @classmethod
    def of(cls, surface: Surface) -> SurfaceGradient:
        """Compute the operators of a mesh."""
        vertices, count = surface.vertices, len(surface.vertices)
        edges = edges_of(surface.faces).vertices
        length = float(np.linalg.norm(vertices[edges[:, 0]] - vertices[edges[:, 1]], axis=1).mean())
        row = np.arange(len(edges))
        ones = np.ones(len(edges))
        difference = sparse.csr_matrix((np.r_[ones, -ones], (np.r_[row, row], edges.T.ravel())), shape=(len(edges), count))
        return cls(_gradient(surface, length), difference, edges, neighbour_average(surface.faces, count, own=False), length)

    def slope(self, values: np.ndarray) -> np.ndarray:
        """Return the gradient (V, 3) of values (V,)."""
        return np.stack([matrix @ values for matrix in self.gradient], 1)


def _gradient(surface: Surface, length: float) -> tuple[sparse.csr_matrix, sparse.csr_matrix, sparse.csr_matrix]:
    """Return the three matrices of `SurfaceGradient.gradient`."""
    vertices, faces = surface.vertices, surface.faces
    a, b, c = (vertices[faces[:, k]] for k in range(3))
    cross = np.cross(b - a, c - a)
    area = np.maximum(np.linalg.norm(cross, axis=1), 1e-12 * length**2)  # twice the area
    normal = cross / area[:, None]
    # The hat function of a corner rises across the opposite edge by 1 over the triangle's height (area times that is the edge).
    rise = [np.cross(normal, edge) * length for edge in (c - b, a - c, b - a)]
    total = np.asarray(sum(np.bincount(faces[:, k], area, len(vertices)) for k in range(3)))
    row = np.concatenate([faces[:, k] for k in range(3) for _ in range(3)])
    column = np.concatenate([faces[:, k] for _ in range(3) for k in range(3)])
    value = np.concatenate(3 * rise) / np.maximum(total[row], 1e-30)[:, None]
    shape = (len(vertices), len(vertices))
    x, y, z = (sparse.csr_matrix((value[:, k], (row, column)), shape=shape) for k in range(3))
    return x, y, z


def subdivided(surface: Surface) -> Surface:
    """Split each triangle into four at the midpoints of its edges; the first vertices are the old ones."""
    faces, count = surface.faces, len(surface.vertices)
    edges = edges_of(faces)
    middle = count + edges.of_side.reshape(-1, 3)
    vertices = np.concatenate([surface.vertices, surface.vertices[edges.vertices].mean(1)])
    normals = np.concatenate([surface.normals, surface.normals[edges.vertices].sum(1)])
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-9)
    corners = [np.stack([faces[:, k], middle[:, k], middle[:, k - 1]], 1) for k in range(3)]
    return Surface(vertices, normals, np.concatenate([*corners, middle]).astype(faces.dtype), surface.voxel / 2)
