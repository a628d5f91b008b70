# SPDX-License-Identifier: GPL-3.0-or-later
"""Visual hull (Laurentini 1994): the largest object that all masks allow, its surface, and its depth in every view."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.ndimage import gaussian_filter
from skimage.measure import marching_cubes

from ..errors import InputError
from ..kernels.cpu.jit import kernel
from ..machine.thread_pool import even_ranges, run_ranges, thread_count
from ..scene.camera import Camera
from ..scene.dataset import Bound, View
from ..scene.surface import draw_on_triangles
from ..scene.triangle_tracer import TriangleTracer
from .mask_limits import widest_mask

HULL_CELLS = 96  # cells along the longest side of the hull
UNSEEN_ALPHA = 2.0  # alpha of a cell that no view has seen yet
MIN_OCCUPIED_ALPHA = 0.1  # alpha of a coarse cell from which the fine grid encloses it
BORDER_CELLS = 1.5  # coarse cells around these that the fine grid encloses, too
SMOOTHING_CELLS = 1.5  # cells, sigma of the blur whose gradient gives the normals


@kernel
def carve_range(begin, end, corner, step, shape, matrix, alpha, inside):
    """Carve planes begin..end of `inside` (X, Y, Z): its minimum with the bilinear alpha of one view; cells outside the image stay."""
    height, width = alpha.shape
    for i in range(begin, end):
        for j in range(shape[1]):
            for k in range(shape[2]):
                x, y, z = corner[0] + i * step, corner[1] + j * step, corner[2] + k * step
                depth = matrix[2, 0] * x + matrix[2, 1] * y + matrix[2, 2] * z + matrix[2, 3]
                if inside[i, j, k] == 0.0 or depth <= 0.0:
                    continue
                u = (matrix[0, 0] * x + matrix[0, 1] * y + matrix[0, 2] * z + matrix[0, 3]) / depth - 0.5
                v = (matrix[1, 0] * x + matrix[1, 1] * y + matrix[1, 2] * z + matrix[1, 3]) / depth - 0.5
                if u < 0.0 or v < 0.0 or u > width - 1.0 or v > height - 1.0:
                    continue
                c, r = min(int(u), width - 2), min(int(v), height - 2)
                fu, fv = u - c, v - r
                top = alpha[r, c] * (1.0 - fu) + alpha[r, c + 1] * fu
                bottom = alpha[r + 1, c] * (1.0 - fu) + alpha[r + 1, c + 1] * fu
                inside[i, j, k] = min(inside[i, j, k], top * (1.0 - fv) + bottom * fv)


@dataclass(frozen=True, eq=False)
class VisualHull:
    """Voxels of the visual hull.

    Attributes:
        inside: (X, Y, Z) float32 minimum over the views of the bilinear alpha at each cell's centre.
        corner: (3,) world position of cell (0, 0, 0).
        step: cell size, world units.
    """

    inside: np.ndarray
    corner: np.ndarray
    step: float

    def triangles(self) -> np.ndarray:
        """Return the triangles (F, 3, 3) of the 0.5 level."""
        vertices, faces, _, _ = marching_cubes(np.pad(self.inside, 1), min(0.5, 0.5 * float(self.inside.max())))
        return ((vertices - 1) * self.step + self.corner)[faces]

    def sample(self, count: int, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray, float]:
        """Draw points uniformly by area on the hull.

        Args:
            count: number of points.
            rng: random generator of the points.

        Returns:
            Points (count, 3), outward unit normals (count, 3), and the hull's area.
        """
        triangles = self.triangles()
        edges = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
        area = 0.5 * np.linalg.norm(edges, axis=1)
        pick, weight = draw_on_triangles(area, count, rng)
        points = (triangles[pick] * weight).sum(1)
        flat = edges[pick] / np.maximum(2 * area[pick, None], 1e-20)
        return points, self._normals(points, flat), float(area.sum())

    def _normals(self, points: np.ndarray, flat: np.ndarray) -> np.ndarray:
        """Return the normals (N, 3) of the smoothed hull at points (N, 3); `flat` (N, 3) where it has no gradient."""
        gradient = np.stack(np.gradient(gaussian_filter(self.inside, SMOOTHING_CELLS)), -1) / self.step
        cell = np.clip(np.round((points - self.corner) / self.step).astype(int), 0, np.array(self.inside.shape) - 1)
        normals = -gradient[tuple(cell.T)]
        length = np.linalg.norm(normals, axis=1, keepdims=True)
        return np.where(length > 1e-6, normals / np.maximum(length, 1e-6), flat)

    def depths(self, cameras: Sequence[Camera]) -> list[tuple[np.ndarray, np.ndarray]]:
        """Return the planar depths (H, W) float32 at which each camera's rays enter and leave the hull; 0 where they miss it."""
        tracer = TriangleTracer(self.triangles())
        far = 2 * max(float(np.linalg.norm(camera.centre - self.corner)) for camera in cameras) + sum(self.inside.shape) * self.step
        return [(_hit(tracer, camera, 0.0), far - _hit(tracer, camera, far, missed=far)) for camera in cameras]

    def entries(self, cameras: Sequence[Camera]) -> list[np.ndarray]:
        """Return the planar depths (H, W) float32 at which each camera's rays enter the hull; 0 where they miss it."""
        tracer = TriangleTracer(self.triangles())
        return [_hit(tracer, camera, 0.0) for camera in cameras]


def _hit(tracer: TriangleTracer, camera: Camera, start: float, missed: float = 0.0) -> np.ndarray:
    """Return the distance (H, W) along the rays, in depth, to the first hit; from depth `start` backwards where it is above 0."""
    rays = camera.rays().reshape(-1, 3)
    origin = np.ascontiguousarray(camera.centre + start * rays, np.float32)
    found = tracer.closest(origin, -rays if start else rays)
    return np.where(found.triangle >= 0, found.distance, missed).astype(np.float32).reshape(camera.height, camera.width)


def visual_hull(views: Sequence[View], bound: Bound, size: int = HULL_CELLS) -> VisualHull:
    """Carve the visual hull from the bound with the masks of all views, coarse then fine.

    `bound.bound_of_masks` also carves, but only estimates the bounding sphere before any bound is known: coarsely, with
    few views, and tolerant of masks that contradict each other.

    Args:
        views: all have masks.
        bound: sphere outside which everything is empty.
        size: cells along the longest side of the hull.

    Raises:
        InputError: no cell is inside all masks.
    """
    centre, radius = np.asarray(bound.centre), bound.radius
    coarse = _carve(views, bound, centre - radius, centre + radius, size // 2)
    cells = np.argwhere(coarse.inside > MIN_OCCUPIED_ALPHA)
    if not len(cells):
        fix = "check cameras and masks, or set data.centre, data.radius; a capture is cut out again by irgspp capture DATASET --sphere"
        raise InputError("masks", "no point of the object's bound is inside all masks", fix)
    low, high = coarse.corner + (cells.min(0) - BORDER_CELLS) * coarse.step, coarse.corner + (cells.max(0) + BORDER_CELLS) * coarse.step
    return _carve(views, bound, low, high, size)


def _carve(views: Sequence[View], bound: Bound, low: np.ndarray, high: np.ndarray, cells: int) -> VisualHull:
    """Carve the box low..high (3,) at `cells` cells along its longest side."""
    step = float((high - low).max()) / cells
    shape = np.maximum(np.ceil((high - low) / step).astype(int) + 1, 3)
    inside = np.full(shape, UNSEEN_ALPHA, np.float32)
    for view in views:
        arrays = (low.astype(np.float32), np.float32(step), shape, view.camera.projection.astype(np.float32), widest_mask(view))
        run_ranges(carve_range, even_ranges(shape[0], thread_count()), *arrays, inside)
    x, y, z = ((low[i] + step * np.arange(shape[i]) - bound.centre[i]) ** 2 for i in range(3))
    # The corners of the box lie outside the bound and often outside every image, where nothing carves them.
    inside[(x[:, None, None] + y[:, None] + z > bound.radius**2) | (inside > 1)] = 0
    return VisualHull(inside, low, step)
