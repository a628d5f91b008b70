# SPDX-License-Identifier: GPL-3.0-or-later
"""Ray queries on a triangle mesh by Embree, on the calling thread."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from embreex.mesh_construction import TriangleMesh
from embreex.rtcore_scene import EmbreeScene

from .camera import Camera


class RayHits(NamedTuple):
    """First triangles that R rays meet.

    Attributes:
        triangle: (R,) int32 index, -1 where a ray meets none; the other values then mean nothing.
        u, v: (R,) float32 barycentric weights of the triangle's second and third corner.
        distance: (R,) float32, in units of the ray's direction.
    """

    triangle: np.ndarray
    u: np.ndarray
    v: np.ndarray
    distance: np.ndarray


class TriangleTracer:
    """Acceleration structure of a triangle mesh; several threads may query it at once.

    Args:
        corners: (F, 3, 3) corners of the triangles, world.
    """

    def __init__(self, corners: np.ndarray) -> None:
        self._scene = EmbreeScene()
        self._mesh = TriangleMesh(self._scene, np.ascontiguousarray(corners, np.float32))  # the scene does not keep it alive
        # The first query commits the scene, which is not thread-safe.
        self._scene.run(np.zeros((1, 3), np.float32), np.array([[0, 0, 1]], np.float32))

    def closest(self, origin: np.ndarray, direction: np.ndarray) -> RayHits:
        """Find the first triangle that each ray meets.

        Args:
            origin: (R, 3) float32 world, contiguous.
            direction: (R, 3) float32 of any length, contiguous.
        """
        found = self._scene.run(origin, direction, query="INTERSECT", output=True)
        return RayHits(found["primID"], found["u"], found["v"], found["tfar"])

    def meet(self, origin: np.ndarray, direction: np.ndarray, reach: np.ndarray | None = None) -> np.ndarray:
        """Find the rays that meet any triangle.

        Args:
            origin: (R, 3) float32 world, contiguous.
            direction: (R, 3) float32 of any length, contiguous.
            reach: (R,) float32 distances up to which triangles count, in units of the direction; None: any distance.

        Returns:
            (R,) bool, True for these rays.
        """
        return self._scene.run(origin, direction, reach, query="OCCLUDED") >= 0

    def seen_by(self, camera: Camera) -> RayHits:
        """Find the triangles that the H W pixels of a camera show, row by row; distances are planar depths."""
        rays = np.ascontiguousarray(camera.rays().reshape(-1, 3))
        return self.closest(np.repeat(camera.centre[None].astype(np.float32), len(rays), 0), rays)
