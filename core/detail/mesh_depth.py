# SPDX-License-Identifier: GPL-3.0-or-later
"""Depth map of a mesh seen by a camera: z-buffer rasterisation, which takes less time than a ray for each texel."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..kernels.cpu.jit import kernel
from ..machine.thread_pool import even_ranges, run_ranges, thread_count
from ..scene.camera import Camera


@dataclass(frozen=True, eq=False)
class MeshDepth:
    """Nearest triangle of a mesh at every pixel.

    Attributes:
        camera: the camera; images are (H, W).
        triangle: (H, W) int32 index, -1 where there is none.
        inverse: (H, W) float32 1 / planar depth, 0 where there is nothing.
        vertex_inverse: (V,) float64 1 / planar depth of the vertices, 0 behind the camera.
        vertex_pixel: (V, 2) float64 pixel coordinates of the vertices.
    """

    camera: Camera
    triangle: np.ndarray
    inverse: np.ndarray
    vertex_inverse: np.ndarray
    vertex_pixel: np.ndarray

    def interpolate(self, values: np.ndarray, faces: np.ndarray, row: np.ndarray, column: np.ndarray) -> np.ndarray:
        """Interpolate vertex values at pixels, with perspective.

        Args:
            values: (V, C) at the vertices.
            faces: (F, 3).
            row: (P,) of pixels that show a triangle.
            column: (P,).

        Returns:
            (P, C).
        """
        corners = faces[self.triangle[row, column]]
        a, b, c = (self.vertex_pixel[corners[:, k]] for k in range(3))
        point = np.stack([column + 0.5, row + 0.5], -1)
        parts = np.stack([_area(b, c, point), _area(c, a, point), _area(a, b, point)], -1) * self.vertex_inverse[corners]
        total = parts.sum(-1, keepdims=True)
        weight = np.clip(parts / np.where(np.abs(total) < 1e-30, 1e-30, total), 0, 1)
        return (values[corners] * weight[..., None]).sum(1) / np.maximum(weight.sum(-1, keepdims=True), 1e-12)


def _area(a: np.ndarray, b: np.ndarray, c: np.ndarray) -> np.ndarray:
    """Return twice the signed areas (P,) of triangles with corners (P, 2)."""
    return (b[:, 0] - a[:, 0]) * (c[:, 1] - a[:, 1]) - (b[:, 1] - a[:, 1]) * (c[:, 0] - a[:, 0])


def render_mesh_depth(vertices: np.ndarray, faces: np.ndarray, camera: Camera) -> MeshDepth:
    """Rasterise a mesh; triangles that reach behind the camera are left out.

    Args:
        vertices: (V, 3) world.
        faces: (F, 3).
        camera: the camera.
    """
    pixel, depth = camera.project(vertices.astype(np.float64))
    inverse = np.where(depth > 0, 1 / np.where(depth > 0, depth, 1), 0)
    triangle = np.full((camera.height, camera.width), -1, np.int32)
    nearest = np.zeros((camera.height, camera.width), np.float32)
    ranges = even_ranges(camera.height, thread_count())
    pixel = np.ascontiguousarray(pixel)
    run_ranges(rasterise_depth, ranges, pixel, inverse, np.ascontiguousarray(faces, np.int32), nearest, triangle)
    return MeshDepth(camera, triangle, nearest, inverse, pixel)


@kernel
def rasterise_depth(begin, end, pixel, inverse, faces, nearest, triangle):
    """Write the nearest triangle of each pixel of the rows begin..end: `nearest` (H, W) 1 / depth, `triangle` (H, W)."""
    width = nearest.shape[1]
    for f in range(faces.shape[0]):
        i, j, k = faces[f, 0], faces[f, 1], faces[f, 2]
        if inverse[i] <= 0 or inverse[j] <= 0 or inverse[k] <= 0:
            continue
        ax, ay, bx, by, cx, cy = pixel[i, 0], pixel[i, 1], pixel[j, 0], pixel[j, 1], pixel[k, 0], pixel[k, 1]
        low, high = min(ay, by, cy), max(ay, by, cy)
        if high < begin or low > end:
            continue
        area = (bx - ax) * (cy - ay) - (by - ay) * (cx - ax)
        if abs(area) < 1e-12:
            continue
        left, right = max(int(min(ax, bx, cx)), 0), min(int(max(ax, bx, cx)) + 1, width)
        for row in range(max(int(low), begin), min(int(high) + 1, end)):
            for column in range(left, right):
                x, y = column + 0.5, row + 0.5
                u = ((cx - bx) * (y - by) - (cy - by) * (x - bx)) / area
                v = ((ax - cx) * (y - cy) - (ay - cy) * (x - cx)) / area
                w = 1 - u - v
                if u >= 0 and v >= 0 and w >= 0:
                    near = u * inverse[i] + v * inverse[j] + w * inverse[k]
                    if near > nearest[row, column]:
                        nearest[row, column] = near
                        triangle[row, column] = f
