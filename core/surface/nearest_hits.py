# SPDX-License-Identifier: GPL-3.0-or-later
"""Points of a fine surface nearest to those of a mesh along the mesh's normals, to both sides."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ..scene.surface import Surface
from ..scene.triangle_tracer import TriangleTracer
from .meshing import unit

REACH = 0.05  # of the mesh's diameter: farther along a normal, another part of the object would be found
LIFT = 0.02  # voxels that rays begin off the mesh by, so that they meet the surface where both coincide


class NearestHits(NamedTuple):
    """Hits of P normals.

    Attributes:
        triangle: (P,) int32 of the fine surface, -1 where none is within reach.
        u, v: (P,) float32 barycentric weights of the triangle's second and third corner.
        height: (P,) float32 signed distance along the normal; infinite where there is none.
    """

    triangle: np.ndarray
    u: np.ndarray
    v: np.ndarray
    height: np.ndarray


class NearestTracer:
    """Tracer of a fine surface along the normals of a mesh.

    Args:
        fine: the surface.
    """

    def __init__(self, fine: Surface) -> None:
        corners = fine.vertices[fine.faces]
        self._fine, self._tracer = fine, TriangleTracer(corners)
        self._facing = unit(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]))
        self._reach = REACH * float(np.linalg.norm(np.ptp(fine.vertices, axis=0)))

    def hits(self, place: np.ndarray, normal: np.ndarray) -> NearestHits:
        """Find the nearer of the first hits to both sides; the back of a surface is the other side of a thin part, and does not count.

        Args:
            place: (P, 3) world, of the mesh.
            normal: (P, 3) unit, of the mesh.
        """
        place, normal = np.asarray(place, np.float32), np.asarray(normal, np.float32)
        count, lift = len(place), np.float32(LIFT * self._fine.voxel)
        u, v = np.zeros((2, count), np.float32)
        best = NearestHits(np.full(count, -1, np.int32), u, v, np.full(count, np.inf, np.float32))
        for side in (np.float32(1), np.float32(-1)):
            found = self._tracer.closest(place - lift * side * normal, side * normal)
            height = found.distance - lift
            front = (found.triangle >= 0) & (height <= self._reach)
            front[front] = (self._facing[found.triangle[front]] * normal[front]).sum(-1) > 0
            nearer = front & (np.abs(height) < np.abs(best.height))
            for mine, new in zip(best, (found.triangle, found.u, found.v, side * height), strict=True):
                mine[nearer] = new[nearer]
        return best

    def normals(self, place: np.ndarray, normal: np.ndarray) -> np.ndarray:
        """Return the unit normals (P, 3) float32 of the fine surface at the hits; the mesh's own where there is none.

        Args:
            place: (P, 3) world, of the mesh.
            normal: (P, 3) unit, of the mesh.
        """
        hits = self.hits(place, normal)
        row = np.flatnonzero(hits.triangle >= 0)
        second, third = hits.u[row, None], hits.v[row, None]
        a, b, c = (self._fine.normals[self._fine.faces[hits.triangle[row], k]] for k in range(3))
        result = np.array(normal, np.float32)
        result[row] = unit((1 - second - third) * a + second * b + third * c)
        return result
