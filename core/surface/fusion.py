# SPDX-License-Identifier: GPL-3.0-or-later
"""Depth of all views fused into a truncated signed distance field (TSDF)."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ..kernels.jit import kernel
from ..kernels.pool import even_ranges, run_ranges, thread_count
from ..progress import Progress
from ..scene.buffers import ViewBuffers
from .grid import BLOCK, Grid

TRUNCATION = 4.0  # voxels
GRAZING = 0.1  # cosine below which a depth says nothing about the distance
CARVED = 0.1  # weight of being seen through, where no depth is near; one depth seen frontally weighs 1
SMOOTHNESS = 0.5  # weight of the neighbours' mean against the depths
RELAXATIONS = 10  # passes; what has no depth is bridged over about as many voxels


def fuse(views: Sequence[ViewBuffers], grid: Grid, progress: Progress) -> np.ndarray:
    """Fuse the views' depth into (B, BLOCK^3) float32 distances of the active blocks, in units of the truncation, -1 inside .. 1 outside.

    Space that no depth tells about continues what is around it; seen through it is rather outside, else inside: small holes close.
    """
    shape = (len(grid.active), BLOCK**3)
    total, weight, free = np.zeros(shape, np.float32), np.zeros(shape, np.float32), np.zeros(shape, np.bool_)
    ranges = even_ranges(len(grid.active), 4 * thread_count())
    truncation = TRUNCATION * grid.voxel
    for done, view in enumerate(views):
        layers = projection(view), *depth_layers(view)
        run_ranges(integrate, ranges, grid.active, grid.origin, grid.voxel, truncation, *layers, total, weight, free)
        progress.step(done + 1)
    carved = free & (weight < CARVED)
    total[carved] += CARVED
    weight[carved] += CARVED
    blank = np.where(free, np.float32(1), np.float32(-1))
    distance = np.where(weight > 0, total / np.maximum(weight, 1e-12), blank)
    table = grid.table()
    for _ in range(RELAXATIONS):
        relaxed = np.empty_like(distance)
        run_ranges(relax, ranges, grid.active, table, SMOOTHNESS, total, weight, distance, relaxed)
        distance = relaxed
    return distance


def projection(view: ViewBuffers) -> np.ndarray:
    """(3, 4) float64 matrix: world point to (u z, v z, z), pixel centres at .5, z planar depth."""
    camera = view.camera
    intrinsics = np.array([[camera.fx, 0, camera.cx], [0, camera.fy, camera.cy], [0, 0, 1.0]])
    return np.ascontiguousarray(intrinsics @ camera.world_to_cv[:3])


def depth_layers(view: ViewBuffers) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Depth (0 = nothing there), |normal . ray| with the planar ray (distance to the plane per depth), and weight; (H, W) float32."""
    rays = view.camera.rays()
    slope = np.abs((view.normal * rays).sum(-1))
    cosine = slope / np.linalg.norm(rays, axis=-1)
    seen = (view.alpha > 0.5) & np.isfinite(view.depth) & (view.depth > 0)
    weight = np.where(seen & (cosine > GRAZING), view.alpha * cosine, 0)
    layers = np.where(seen, view.depth, 0), slope, weight
    depth, slope, weight = (np.ascontiguousarray(x, np.float32) for x in layers)
    return depth, slope, weight


@kernel
def integrate(begin, end, active, origin, voxel, truncation, matrix, depth, slope, weight, total, sum_weight, free):
    """Add one view to the blocks begin..end: weighted distance to the tangent plane seen along the voxel's ray."""
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
            if depth[row, column] == 0:
                free[b, i] = True
                continue
            surface = depth[row, column]
            c, r = int(max(u - 0.5, 0.0)), int(max(v - 0.5, 0.0))
            if c + 1 < width and r + 1 < height:
                a00, a01, a10, a11 = depth[r, c], depth[r, c + 1], depth[r + 1, c], depth[r + 1, c + 1]
                near = min(min(a00, a01), min(a10, a11))
                # Interpolating across a depth edge would put a surface into thin air.
                if near > 0 and max(max(a00, a01), max(a10, a11)) - near < truncation:
                    s, t = min(max(u - 0.5 - c, 0.0), 1.0), min(max(v - 0.5 - r, 0.0), 1.0)
                    surface = (1 - t) * ((1 - s) * a00 + s * a01) + t * ((1 - s) * a10 + s * a11)
            behind = far - surface
            distance = -behind * slope[row, column]
            if behind < -truncation or distance > 0.5 * truncation:
                free[b, i] = True
            if weight[row, column] == 0 or distance < -truncation or behind > 3 * truncation:
                continue
            # Fades out behind the surface: the far side of a thin part belongs to other views.
            w = weight[row, column] * min(1.0, 1.0 + distance / truncation)
            total[b, i] += w * min(1.0, distance / truncation)
            sum_weight[b, i] += w


@kernel
def relax(begin, end, active, table, smoothness, total, weight, distance, relaxed):
    """One Jacobi pass over the blocks begin..end: each distance between what the depths say and the mean of its six neighbours."""
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
