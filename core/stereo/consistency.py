# SPDX-License-Identifier: GPL-3.0-or-later
"""Agreement between depth maps: a depth has support where another view's depth leads there and back."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ..kernels.cpu.jit import helper, kernel
from .depth_map import DepthMap, camera_matrices
from .settings import StereoSettings


def support(depth_map: DepthMap, witnesses: Sequence[DepthMap], settings: StereoSettings) -> np.ndarray:
    """Count the witnesses that agree with each depth of a view.

    A witness agrees where its depth at the projected point differs by a small fraction, its own point projects back near the pixel, and
    the normals are alike.

    Args:
        depth_map: depth map of the view.
        witnesses: depth maps of other views.
        settings: limits of the agreement, and of the cost.

    Returns:
        (H, W) uint8 counts, 0 where there is no depth or its cost is too high.
    """
    depth = np.where(depth_map.cost <= settings.largest_cost, depth_map.depth, np.float32(0))
    count = np.zeros(depth.shape, np.uint8)
    own = camera_matrices(depth_map.camera)
    limits = settings.reprojection, settings.relative_depth, settings.cosine
    for other in witnesses:
        add_agreement(own, camera_matrices(other.camera), depth, depth_map.normal, other.depth, other.normal, *limits, count)
    return count


@helper
def apply(matrix, x, y, z):
    """Return the product of a matrix (3, 4) with (x, y, z, 1)."""
    a = matrix[0, 0] * x + matrix[0, 1] * y + matrix[0, 2] * z + matrix[0, 3]
    b = matrix[1, 0] * x + matrix[1, 1] * y + matrix[1, 2] * z + matrix[1, 3]
    return a, b, matrix[2, 0] * x + matrix[2, 1] * y + matrix[2, 2] * z + matrix[2, 3]


@helper
def pixel_seeing(projection, x, y, z, depth, relative):
    """Return row and column of the pixel that sees a world point, and the point's depth; row -1 where `depth` there differs too much."""
    a, b, far = apply(projection, x, y, z)
    if far <= 0 or a < 0 or b < 0:
        return -1, -1, far
    u, v = a / far, b / far
    if u >= depth.shape[1] or v >= depth.shape[0]:
        return -1, -1, far
    row, column = int(v), int(u)
    d = depth[row, column]
    if d <= 0 or abs(d - far) > relative * far:
        return -1, -1, far
    return row, column, far


@kernel
def add_agreement(own, its, depth, normal, other_depth, other_normal, pixels, relative, cosine, count):
    """Add 1 to `count` (H, W) where another view's depth and normal agree; own and its: `camera_matrices` of the two views."""
    for row in range(depth.shape[0]):
        for column in range(depth.shape[1]):
            d = float(depth[row, column])
            if d <= 0:
                continue
            u, v = column + 0.5, row + 0.5
            x, y, z = apply(own[1], u * d, v * d, d)
            r, c, _ = pixel_seeing(its[0], x, y, z, other_depth, relative)
            if r < 0:
                continue
            # Back from the centre of the other pixel, which is up to 0.7 pixels from the point.
            e = float(other_depth[r, c])
            x, y, z = apply(its[1], (c + 0.5) * e, (r + 0.5) * e, e)
            a, b, back = apply(own[0], x, y, z)
            if back <= 0 or (a / back - u) ** 2 + (b / back - v) ** 2 > pixels * pixels:
                continue
            n, m = normal[row, column], other_normal[r, c]
            if n[0] * m[0] + n[1] * m[1] + n[2] * m[2] > cosine:
                count[row, column] += 1


@kernel
def add_samples(points, its, centre, depth, normal, colour, relative, used, sums, total):
    """Add another view's points, normals and colours to the sums (N, 9) of the points (N, 3) that it sees at about the same depth.

    `total` (N,) counts the samples; `used` (H, W) marks the other view's pixels that were added. Its point is taken where the ray through
    the projected point meets the pixel's plane, not at the pixel's centre.
    """
    for i in range(points.shape[0]):
        x, y, z = points[i, 0], points[i, 1], points[i, 2]
        r, c, far = pixel_seeing(its[0], x, y, z, depth, relative)
        if r < 0:
            continue
        d, n = float(depth[r, c]), normal[r, c]
        px, py, pz = apply(its[1], (c + 0.5) * d, (r + 0.5) * d, d)
        scale = d / far
        along = n[0] * (x - centre[0]) + n[1] * (y - centre[1]) + n[2] * (z - centre[2])
        if along < 0:  # else the plane is seen edge-on within the pixel
            plane = (n[0] * (px - centre[0]) + n[1] * (py - centre[1]) + n[2] * (pz - centre[2])) / along
            if abs(plane - scale) < relative * scale:
                scale = plane
        sums[i, 0] += centre[0] + scale * (x - centre[0])
        sums[i, 1] += centre[1] + scale * (y - centre[1])
        sums[i, 2] += centre[2] + scale * (z - centre[2])
        for k in range(3):
            sums[i, 3 + k] += normal[r, c, k]
            sums[i, 6 + k] += colour[r, c, k]
        total[i] += 1
        used[r, c] = True
