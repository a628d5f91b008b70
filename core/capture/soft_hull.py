# SPDX-License-Identifier: GPL-3.0-or-later
"""Soft visual hull: voxels that nearly all masks contain, and its silhouettes as the other views say them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from ..io.grown_mask import grown_mask
from ..kernels.cpu.jit import kernel
from ..machine.thread_pool import even_ranges, run_jobs, run_ranges, thread_count
from ..scene.camera import Camera
from ..scene.dataset import Bound
from .support_plane import SupportPlane

COARSE_CELLS = 40  # cells along the bound's diameter
FINE_PIXELS = 2.0  # largest side of a voxel at the silhouette
MAX_CELL_PARTS = 8  # most parts of a coarse cell's side
MAX_COARSE_CONTRADICTION = 0.35  # fraction of the views that may contradict a coarse cell
# Fractions of contradicting views at which a voxel is surely inside, and surely outside.
INSIDE_CONTRADICTION, OUTSIDE_CONTRADICTION = 0.03, 0.15
MIN_SEEN_FRACTION = 0.3  # fraction of the views that must say something about a voxel
MAX_WIDENING = 64  # pixels by which masks are widened or narrowed, at most
SILHOUETTE_BLUR = 0.8  # pixels, sigma of the silhouettes' blur


@dataclass(frozen=True, eq=False)
class _Voxels:
    """Cubes of one size.

    Attributes:
        centres: (N, 3) float64.
        step: side, world units.
        misses: (N,) float32 sum over the views of 1 - mask, weighted.
        views: (N,) float32 weights of the views that say something.
    """

    centres: np.ndarray
    step: float
    misses: np.ndarray
    views: np.ndarray

    def select(self, keep: np.ndarray) -> _Voxels:
        """Return the cubes where `keep` (N,) is True."""
        return _Voxels(self.centres[keep], self.step, self.misses[keep], self.views[keep])


@dataclass(frozen=True, eq=False)
class SoftHull:
    """Voxels of the hull, small at its surface.

    Attributes:
        levels: coarse and fine voxels.
        masks: (H, W) uint8 0..254 of each view, narrowed as the fine voxels were carved with, or None.
        weights: (V,) weights of the views.
    """

    levels: list[_Voxels]
    masks: Sequence[np.ndarray | None]
    weights: np.ndarray

    def points(self) -> np.ndarray:
        """Return the centres (N, 3) of the voxels that are rather inside than outside."""
        return np.concatenate([level.centres[_occupancy(level.misses, level.views) > 0.5] for level in self.levels])

    def silhouette(self, camera: Camera, own: int) -> np.ndarray:
        """Return (H, W) float32 0..1, how surely pixels of a view see the hull by what the other views say.

        Args:
            camera: camera of the view.
            own: its index among the masks.
        """
        image = np.zeros((camera.height, camera.width), np.float32)
        matrix, mask = camera.projection, self.masks[own]
        for level in self.levels:
            misses, views = level.misses, level.views
            if mask is not None and self.weights[own] > 0:
                misses, views = misses.copy(), views.copy()
                _add_votes(0, len(misses), level.centres, matrix, mask, -np.float32(self.weights[own]), _closed(mask), misses, views)
            _splat(level.centres, np.float32(0.5 * level.step * camera.fx), matrix, _occupancy(misses, views), image)
        return cv2.GaussianBlur(image, (0, 0), SILHOUETTE_BLUR)


def soft_hull(
    cameras: Sequence[Camera],
    masks: Sequence[np.ndarray | None],
    weights: np.ndarray,
    bound: Bound,
    plane: SupportPlane | None,
    widening: float = 0.0,
) -> SoftHull | None:
    """Carve the soft hull: coarse cells, of which those at the surface are divided.

    A voxel is inside a mask if the whole cube is, so masks are narrowed by half a voxel, and the silhouettes of the cubes fit the masks.

    Args:
        cameras: cameras of all views.
        masks: (H, W) float32 in 0..1 of each view, None where there is none.
        weights: (V,) of the views, 0 where a mask is not to be trusted.
        bound: sphere outside which everything is empty.
        plane: under which everything is empty, or None.
        widening: pixels by which the masks are widened, as they may be wrong by so much.

    Returns:
        The hull, None where no voxel is left.
    """
    bytes_ = [None if mask is None else np.round(254 * np.clip(mask, 0, 1)).astype(np.uint8) for mask in masks]
    step = 2 * bound.radius / COARSE_CELLS
    sides = np.array([step * camera.fx / max(float(camera.project(np.asarray(bound.centre)[None])[1][0]), 1e-9) for camera in cameras])
    cells = _cells(bound, step, plane)
    loose = _voted(cells, step, cameras, _resized(bytes_, widening + 0.87 * sides), weights)
    cells = cells[(loose.misses < MAX_COARSE_CONTRADICTION * loose.views) & (loose.views > MIN_SEEN_FRACTION * weights.sum())]
    strict = _voted(cells, step, cameras, _resized(bytes_, widening - 0.87 * sides), weights)
    inner = (strict.misses < INSIDE_CONTRADICTION * strict.views) & (strict.views > MIN_SEEN_FRACTION * weights.sum())
    parts = int(np.clip(np.ceil(np.median(sides) / FINE_PIXELS), 2, MAX_CELL_PARTS))
    offsets = (np.stack(np.meshgrid(*[np.arange(parts)] * 3, indexing="ij"), -1).reshape(-1, 3) + 0.5) / parts - 0.5
    fine = (cells[~inner][:, None] + step * offsets).reshape(-1, 3)
    if plane is not None:
        fine = fine[plane.height(fine) > 0]
    narrowed = _resized(bytes_, widening - 0.5 * sides / parts)
    voxels = _voted(fine, step / parts, cameras, narrowed, weights)
    voxels = voxels.select((voxels.misses < OUTSIDE_CONTRADICTION * voxels.views) & (voxels.views > MIN_SEEN_FRACTION * weights.sum()))
    hull = SoftHull([strict.select(inner), voxels], narrowed, weights)
    return hull if inner.any() or len(voxels.centres) else None


def _cells(bound: Bound, step: float, plane: SupportPlane | None) -> np.ndarray:
    """Return the centres (N, 3) of the coarse cells that fill a sphere above the plane."""
    axis = (np.arange(COARSE_CELLS) + 0.5) * step - bound.radius
    cells = np.stack(np.meshgrid(axis, axis, axis, indexing="ij"), -1).reshape(-1, 3)
    cells = cells[np.linalg.norm(cells, axis=1) < bound.radius + step] + bound.centre
    return cells if plane is None else cells[plane.height(cells) > -step]


def _occupancy(misses: np.ndarray, views: np.ndarray) -> np.ndarray:
    """Return (N,) float32 0..1, how surely voxels are inside."""
    share = misses / np.maximum(views, 1e-6)
    return np.clip((OUTSIDE_CONTRADICTION - share) / (OUTSIDE_CONTRADICTION - INSIDE_CONTRADICTION), 0, 1).astype(np.float32)


def _resized(masks: Sequence[np.ndarray | None], pixels: np.ndarray) -> list[np.ndarray | None]:
    """Return masks (H, W) uint8 that are widened (> 0) or narrowed (< 0) by pixels (V,), rounded."""
    reaches = np.clip(pixels, -MAX_WIDENING, MAX_WIDENING)
    return [None if mask is None else grown_mask(mask, reach) for mask, reach in zip(masks, reaches, strict=True)]


def _closed(mask: np.ndarray) -> bool:
    """Return True where a mask does not reach the image's border: the object is wholly inside the image."""
    return not bool((mask[[0, -1]] > 127).any() or (mask[:, [0, -1]] > 127).any())


def _voted(centres: np.ndarray, step: float, cameras: Sequence[Camera], masks: Sequence[np.ndarray | None], weights: np.ndarray) -> _Voxels:
    """Return voxels at centres (N, 3) with the votes of all views."""
    misses, views = np.zeros(len(centres), np.float32), np.zeros(len(centres), np.float32)
    ranges = even_ranges(len(centres), thread_count())
    for camera, mask, weight in zip(cameras, masks, weights, strict=True):
        if mask is not None and weight > 0 and ranges:
            matrix = camera.projection
            run_ranges(_add_votes, ranges, centres, matrix, mask, np.float32(weight), _closed(mask), misses, views)
    return _Voxels(centres, step, misses, views)


@kernel
def _add_votes(begin, end, centres, matrix, mask, weight, closed, misses, views):
    """Add a view's misses (0..weight) and weight for voxels begin..end; a closed mask is 0 beside its image, another says nothing there."""
    height, width = mask.shape
    for n in range(begin, end):
        x, y, z = centres[n, 0], centres[n, 1], centres[n, 2]
        depth = matrix[2, 0] * x + matrix[2, 1] * y + matrix[2, 2] * z + matrix[2, 3]
        if depth <= 0.0:
            continue
        u = (matrix[0, 0] * x + matrix[0, 1] * y + matrix[0, 2] * z + matrix[0, 3]) / depth - 0.5
        v = (matrix[1, 0] * x + matrix[1, 1] * y + matrix[1, 2] * z + matrix[1, 3]) / depth - 0.5
        if u < 0.0 or v < 0.0 or u > width - 1.0 or v > height - 1.0:
            if closed:
                misses[n] += weight
                views[n] += weight
            continue
        c, r = min(int(u), width - 2), min(int(v), height - 2)
        s, t = u - c, v - r
        top = mask[r, c] * (1.0 - s) + mask[r, c + 1] * s
        bottom = mask[r + 1, c] * (1.0 - s) + mask[r + 1, c + 1] * s
        misses[n] += weight * (1.0 - (top * (1.0 - t) + bottom * t) / 254.0)
        views[n] += weight


@kernel
def _splat(centres, reach, matrix, value, image):
    """Raise the pixels (H, W) that voxels cover to their values (N,); reach: half a voxel's side times the focal length."""
    height, width = image.shape
    for n in range(centres.shape[0]):
        if value[n] <= 0.0:
            continue
        x, y, z = centres[n, 0], centres[n, 1], centres[n, 2]
        depth = matrix[2, 0] * x + matrix[2, 1] * y + matrix[2, 2] * z + matrix[2, 3]
        if depth <= 0.0:
            continue
        u = (matrix[0, 0] * x + matrix[0, 1] * y + matrix[0, 2] * z + matrix[0, 3]) / depth
        v = (matrix[1, 0] * x + matrix[1, 1] * y + matrix[1, 2] * z + matrix[1, 3]) / depth
        half = reach / depth
        left, right = max(int(np.floor(u - half)), 0), min(int(np.floor(u + half)), width - 1)
        top, bottom = max(int(np.floor(v - half)), 0), min(int(np.floor(v + half)), height - 1)
        for r in range(top, bottom + 1):
            for c in range(left, right + 1):
                if image[r, c] < value[n]:
                    image[r, c] = value[n]


def projected_voxels(camera: Camera, centres: np.ndarray, step: float) -> np.ndarray:
    """Return (H, W) float32, 1 where a camera sees one of the cubes with centres (N, 3) and a side in world units, else 0."""
    image = np.zeros((camera.height, camera.width), np.float32)
    centres, reach = np.ascontiguousarray(centres), np.float32(0.5 * step * camera.fx)
    _splat(centres, reach, camera.projection, np.ones(len(centres), np.float32), image)
    return image


def silhouettes(hull: SoftHull, cameras: Sequence[Camera]) -> list[np.ndarray]:
    """Return the silhouettes (H, W) of the hull in all views, each without what its own mask says."""
    return list(run_jobs(hull.silhouette, [(camera, i) for i, camera in enumerate(cameras)]))
