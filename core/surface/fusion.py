# SPDX-License-Identifier: GPL-3.0-or-later
"""Truncated signed distance field (TSDF) fusion of all views' depth (Curless and Levoy 1996), by distances to tangent planes."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from scipy import ndimage

from ..kernels.cpu.jit import helper, kernel
from ..machine.thread_pool import even_ranges, run_ranges, thread_count
from ..progress.protocol import Progress
from ..scene.gbuffer import GBuffer
from .voxel_grid import BLOCK, Grid

TRUNCATION = 4.0  # voxels
MIN_FACING = 0.1  # cosine between normal and ray below which a depth is ignored
EMPTY_WEIGHT = 0.1  # weight of empty space that a view looks through near the object; a depth seen frontally has weight 1
SMOOTHNESS = 0.5  # weight of the neighbours' mean against the depths
RELAXATIONS = 10  # smoothing passes; gaps without depth are bridged over about as many voxels


class VoxelBlocks(NamedTuple):
    """Active blocks of a voxel grid.

    Attributes:
        active: (B, 3) int32 block coordinates.
        origin: (3,) centre of the first voxel, world.
        voxel: side of a voxel, world units.
        truncation: distance at which signed distances are cut off, world units.
    """

    active: np.ndarray
    origin: np.ndarray
    voxel: float
    truncation: float


class PlaneLayers(NamedTuple):
    """Layers of a view that voxels look up.

    Attributes:
        projection: (3, 4) from the world to pixels and planar depth.
        depth: (H, W) float32, 0 where there is none.
        planes: (H, W, 4) float32, unit normal n and w = -n . p of the surface point p at each pixel's centre: n . x + w is x's distance.
        weight: (H, W) float32, alpha times the cosine between normal and ray.
        smooth: (H - 1, W - 1) bool, True where the four pixels around a corner show one surface.
        gap: (H, W) float32, distance in pixels from a pixel without depth to the nearest with depth.
        pixel: width of a pixel at depth 1.
    """

    projection: np.ndarray
    depth: np.ndarray
    planes: np.ndarray
    weight: np.ndarray
    smooth: np.ndarray
    gap: np.ndarray
    pixel: float


class DistanceSums(NamedTuple):
    """Sums over views at the voxels of B blocks, each (B, BLOCK^3), changed in place.

    Attributes:
        distance: float32 sum of weighted signed distances in units of the truncation distance.
        weight: float32 sum of the weights.
        free: bool, True where a view looks through the voxel.
    """

    distance: np.ndarray
    weight: np.ndarray
    free: np.ndarray


def fuse(views: Sequence[GBuffer], grid: Grid, progress: Progress, floor: float | None = None) -> np.ndarray:
    """Fuse the depth of all views into signed distances of the grid's active blocks.

    Voxels without depth continue their surroundings smoothly, with a weak preference for outside where a view looks through them, so
    that small holes close.

    Args:
        views: G-buffers.
        grid: voxel grid with B active blocks.
        progress: receives the number of views done.
        floor: height Z below which everything is outside, or None. No view sees what the object stands on from below.

    Returns:
        (B, BLOCK^3) float32 distances in units of the truncation distance, from -1 inside to 1 outside.
    """
    shape = (len(grid.active), BLOCK**3)
    sums = DistanceSums(np.zeros(shape, np.float32), np.zeros(shape, np.float32), np.zeros(shape, np.bool_))
    total, weight, free = sums
    ranges = even_ranges(len(grid.active), 4 * thread_count())
    blocks = VoxelBlocks(grid.active, grid.origin, grid.voxel, TRUNCATION * grid.voxel)
    for done, view in enumerate(views):
        run_ranges(integrate, ranges, blocks, plane_layers(view, grid.voxel), sums)
        progress.step(done + 1)
    carved = free & (weight < EMPTY_WEIGHT)
    total[carved] += EMPTY_WEIGHT
    weight[carved] += EMPTY_WEIGHT
    distance = np.where(weight > 0, total / np.maximum(weight, 1e-12), np.float32(-1))
    table = grid.table()
    for _ in range(RELAXATIONS):
        relaxed = np.empty_like(distance)
        run_ranges(relax, ranges, grid.active, table, SMOOTHNESS, total, weight, distance, relaxed)
        distance = relaxed
    if floor is not None:
        height = grid.origin[2] + grid.voxel * (BLOCK * grid.active[:, 2:] + np.arange(BLOCK**3) % BLOCK)
        distance = np.maximum(distance, np.clip((floor - height) / blocks.truncation, -1, 1).astype(np.float32))
    return distance


def plane_layers(view: GBuffer, voxel: float) -> PlaneLayers:
    """Prepare the layers of a view that voxels look up.

    Args:
        view: G-buffer.
        voxel: side of a voxel, world units.
    """
    rays = view.camera.rays()
    seen = (view.alpha > 0.5) & np.isfinite(view.depth) & (view.depth > 0)
    depth = np.where(seen, view.depth, 0).astype(np.float32)
    points = view.camera.centre + depth[..., None].astype(np.float64) * rays
    planes = np.concatenate([view.normal, -(view.normal * points).sum(-1, keepdims=True)], -1)
    cosine = -(view.normal * rays).sum(-1) / np.linalg.norm(rays, axis=-1)
    weight = np.where(seen & (cosine > MIN_FACING), view.alpha * cosine, 0)
    gap = np.asarray(ndimage.distance_transform_edt(~seen), np.float32) if seen.any() else np.full(depth.shape, np.inf, np.float32)
    pixel = min(1 / view.camera.fx, 1 / view.camera.fy)
    smooth = _smooth_corners(planes, points, weight, voxel)
    return PlaneLayers(view.camera.projection, depth, planes.astype(np.float32), weight.astype(np.float32), smooth, gap, pixel)


def _smooth_corners(planes: np.ndarray, points: np.ndarray, weight: np.ndarray, voxel: float) -> np.ndarray:
    """Return (H - 1, W - 1) bool: True where opposite pixels of a corner lie in each other's plane, up to a voxel."""
    smooth = np.ones((weight.shape[0] - 1, weight.shape[1] - 1), bool)
    corners = [(slice(i, i - 1 or None), slice(j, j - 1 or None)) for i, j in ((0, 0), (1, 1), (0, 1), (1, 0))]
    for one, other in zip(corners, [corners[1], corners[0], corners[3], corners[2]], strict=True):
        apart = (planes[one][..., :3] * points[other]).sum(-1) + planes[one][..., 3]
        smooth &= (weight[one] > 0) & (np.abs(apart) < voxel)
    return smooth


@helper
def _to_plane(plane, x, y, z):
    """Return the signed distance of a point to a plane (4,), positive in front."""
    return plane[0] * x + plane[1] * y + plane[2] * z + plane[3]


@helper
def _between_planes(planes, row, column, s, t, x, y, z):
    """Return the distance of a point to the planes of four pixels from (row, column) on, bilinearly at (s, t) between them."""
    upper = (1 - s) * _to_plane(planes[row, column], x, y, z) + s * _to_plane(planes[row, column + 1], x, y, z)
    lower = (1 - s) * _to_plane(planes[row + 1, column], x, y, z) + s * _to_plane(planes[row + 1, column + 1], x, y, z)
    return (1 - t) * upper + t * lower


@kernel
def integrate(begin, end, blocks, layers, sums):
    """Add the `PlaneLayers` of one view to the `DistanceSums` of the `VoxelBlocks` begin..end."""
    active, origin, voxel, truncation = blocks
    matrix, depth, planes, weight, smooth, gap, pixel = layers
    total, sum_weight, free = sums
    height, width = depth.shape
    for b in range(begin, end):
        for i in range(BLOCK * BLOCK * BLOCK):
            x = origin[0] + voxel * (active[b, 0] * BLOCK + i // (BLOCK * BLOCK))
            y = origin[1] + voxel * (active[b, 1] * BLOCK + i // BLOCK % BLOCK)
            z = origin[2] + voxel * (active[b, 2] * BLOCK + i % BLOCK)
            far = matrix[2, 0] * x + matrix[2, 1] * y + matrix[2, 2] * z + matrix[2, 3]
            if far <= 0:
                continue
            u = (matrix[0, 0] * x + matrix[0, 1] * y + matrix[0, 2] * z + matrix[0, 3]) / far
            v = (matrix[1, 0] * x + matrix[1, 1] * y + matrix[1, 2] * z + matrix[1, 3]) / far
            if not (0 <= u < width and 0 <= v < height):
                continue
            column, row = int(u), int(v)
            behind = far - depth[row, column]
            w = weight[row, column]
            free[b, i] |= gap[row, column] > 0 or behind < -truncation
            if gap[row, column] * far * pixel > truncation:  # everything that the view sees is farther away than the truncation
                total[b, i] += 1
                sum_weight[b, i] += 1
            if w == 0 or behind > 1.5 * truncation:
                continue
            distance = _to_plane(planes[row, column], x, y, z)
            c, r = int(u - 0.5), int(v - 0.5)
            if u > 0.5 and v > 0.5 and c + 1 < width and r + 1 < height and smooth[r, c]:
                distance = _between_planes(planes, r, c, u - 0.5 - c, v - 0.5 - r, x, y, z)
            if distance < -truncation:
                continue
            # The weight fades out behind the surface: other views see the far side of a thin part.
            w *= min(1.0, 1.0 + distance / truncation)
            total[b, i] += w * min(1.0, distance / truncation)
            sum_weight[b, i] += w


@kernel
def relax(begin, end, active, table, smoothness, total, weight, distance, relaxed):
    """Do one Jacobi pass over the blocks begin..end: `relaxed` (B, BLOCK^3) mixes the depths' distance and the six neighbours' mean."""
    for b in range(begin, end):
        for i in range(BLOCK * BLOCK * BLOCK):
            mean, count = 0.0, 0
            for axis in range(3):
                stride = 1 if axis == 2 else BLOCK if axis == 1 else BLOCK * BLOCK
                place = i // stride % BLOCK
                for step in (-1, 1):
                    block, j = b, i + step * stride
                    if not 0 <= place + step < BLOCK:
                        x, y, z = active[b, 0] + 1, active[b, 1] + 1, active[b, 2] + 1
                        block = table[x + step * (axis == 0), y + step * (axis == 1), z + step * (axis == 2)]
                        j = i - step * stride * (BLOCK - 1)
                    if block >= 0:
                        mean += distance[block, j]
                        count += 1
            mean = mean / count if count > 0 else distance[b, i]
            relaxed[b, i] = (total[b, i] + smoothness * mean) / (weight[b, i] + smoothness)
