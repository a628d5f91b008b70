# SPDX-License-Identifier: GPL-3.0-or-later
"""CPU kernels of stereo's matching cost: bilateral NCC of a patch on a plane with its warped images in other views.

See core/stereo/patch_match.py. Axes are OpenCV's: +X right, +Y down, +Z into the scene. A plane is given at the middle of a pixel, by its
depth along the ray (x, y, 1) and its unit normal, which points towards the camera. The patch is warped by the derivative of the plane's
homography at the middle, which is exact enough for nine pixels and needs no division for each sample.

Wang et al. 2019 and Schoenberger et al. 2016 describe the bilateral NCC and the geometric consistency term.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ..constants import (
    BRIGHTNESS_RANGE,
    FLAT_VARIANCE,
    LARGEST_REPROJECTION,
    PATCH_REACH,
    PATCH_SAMPLES,
    PATCH_SPACING,
    WARPED_AREA,
    WARPED_REACH,
    WEAK_VARIANCE,
    WEIGHT_CUT,
    WORST_COST,
)
from .jit import helper

_ROWS, _COLUMNS = PATCH_SPACING * (np.mgrid[: 2 * PATCH_REACH + 1, : 2 * PATCH_REACH + 1].reshape(2, -1) - PATCH_REACH).astype(np.float32)
_FALLOFF = np.exp(-0.5 * (_ROWS**2 + _COLUMNS**2) / (PATCH_REACH * PATCH_SPACING) ** 2).astype(np.float32)  # spatial part of the weights
_SMALLEST, _LARGEST = WARPED_AREA
_OUTSIDE = np.float32(-1)  # column of a patch that the source cannot see


class Sources(NamedTuple):
    """Source views of a reference view, their images one after another, T pixels in all.

    Attributes:
        pose: (S, 16) float32, rotation (9) and translation (3) from the reference's axes to the source's, then fx, fy, cx, cy.
        layout: (S, 3) uint32, first pixel, height and width of each image.
        grey: (T,) float32 grey values in 0..1.
        inside: (T,) bool, True on the object.
        depth: (T,) float32 planar depths, 0 where there is none; a single 0 where geometric consistency is not asked for.
    """

    pose: np.ndarray
    layout: np.ndarray
    grey: np.ndarray
    inside: np.ndarray
    depth: np.ndarray


class Penalties(NamedTuple):
    """What is added to 1 - NCC.

    Attributes:
        reprojection: for one pixel of reprojection error to the source's depth.
        brightness: where the patches' means differ by BRIGHTNESS_RANGE or more, less in proportion; less, too, where there is texture.
    """

    reprojection: np.float32
    brightness: np.float32


@helper
def read_patch(grey, inside, row, column, inverse_sigma, centred, weights):
    """Fill the weights (sum 1) and the weighted, centred grey values (PATCH_SAMPLES,) of a pixel's patch; return its variance and mean.

    A sample's weight falls with its distance and its difference from the middle; outside the object it is 0.
    """
    height, width = grey.shape
    middle = grey[row, column]
    total, mean = np.float32(0), np.float32(0)
    k = 0
    for i in range(-PATCH_REACH, PATCH_REACH + 1):
        r = min(max(row + i * PATCH_SPACING, 0), height - 1)
        for j in range(-PATCH_REACH, PATCH_REACH + 1):
            c = min(max(column + j * PATCH_SPACING, 0), width - 1)
            value, weight = grey[r, c], np.float32(0)
            difference = abs(value - middle) * inverse_sigma
            if inside[r, c] and difference < WEIGHT_CUT:
                weight = np.exp(-difference) * _FALLOFF[k]
            centred[k], weights[k] = value, weight
            total += weight
            mean += weight * value
            k += 1
    if total <= 0:
        return np.float32(0), np.float32(0)
    scale, variance = np.float32(1) / total, np.float32(0)
    mean *= scale
    for k in range(PATCH_SAMPLES):
        offset, weight = centred[k] - mean, weights[k] * scale
        variance += weight * offset * offset
        centred[k], weights[k] = weight * offset, weight
    return variance, mean


@helper
def _warp(x, y, depth, nx, ny, nz, fx, fy, pose):
    """Return the patch's middle (u, v) in a source, with pixel centres at integers, and the derivatives of u and v by column and row."""
    zero = np.float32(0)
    ax = pose[0] * x + pose[1] * y + pose[2]
    ay = pose[3] * x + pose[4] * y + pose[5]
    az = pose[6] * x + pose[7] * y + pose[8]
    far = depth * az + pose[11]
    if far <= np.float32(1e-6) * depth:
        return _OUTSIDE, _OUTSIDE, zero, zero, zero, zero
    inverse = np.float32(1) / far
    px, py = (depth * ax + pose[9]) * inverse, (depth * ay + pose[10]) * inverse
    # On the plane n . X = const, depth(x) = depth (n . ray) / (n . ray(x)): its slope by x is -depth nx / (n . ray).
    steep = -depth / (nx * x + ny * y + nz)
    across, down, slope_x, slope_y = depth / fx, depth / fy, steep * nx / fx, steep * ny / fy
    zu, zv = slope_x * az + across * pose[6], slope_y * az + down * pose[7]
    xu, xv = slope_x * ax + across * pose[0], slope_y * ax + down * pose[1]
    yu, yv = slope_x * ay + across * pose[3], slope_y * ay + down * pose[4]
    gx, gy = pose[12] * inverse, pose[13] * inverse
    u, v = pose[12] * px + pose[14] - np.float32(0.5), pose[13] * py + pose[15] - np.float32(0.5)
    return u, v, gx * (xu - px * zu), gx * (xv - px * zv), gy * (yu - py * zu), gy * (yv - py * zv)


@helper
def _correlate(grey, first, width, u, v, uc, ur, vc, vr, centred, weights, variance, level, brightness):
    """Return 1 - NCC of the patch with its bilinear samples in a source, plus the cost of brightness; WORST_COST without texture."""
    mean, square, cross = np.float32(0), np.float32(0), np.float32(0)
    stride = np.uint32(width)
    for k in range(PATCH_SAMPLES):
        column, row = u + uc * _COLUMNS[k] + ur * _ROWS[k], v + vc * _COLUMNS[k] + vr * _ROWS[k]
        c, r = np.int32(column), np.int32(row)
        s, t = column - np.float32(c), row - np.float32(r)
        at = np.uint32(first) + np.uint32(r) * stride + np.uint32(c)  # unsigned: numba then generates no code for negative indices
        upper, lower = grey[at], grey[at + stride]
        upper += s * (grey[at + np.uint32(1)] - upper)
        lower += s * (grey[at + stride + np.uint32(1)] - lower)
        value = upper + t * (lower - upper)
        weighted = weights[k] * value
        mean += weighted
        square += weighted * value
        cross += centred[k] * value
    spread = square - mean * mean
    if spread < FLAT_VARIANCE:
        return WORST_COST
    weight = brightness * WEAK_VARIANCE / (WEAK_VARIANCE + variance)
    return np.float32(1) - cross / np.sqrt(spread * variance) + weight * min(abs(mean - level) / BRIGHTNESS_RANGE, np.float32(1))


@helper
def _reprojection_error(x, y, u, v, fx, fy, pose, depth):
    """Return the distance in pixels between (x, y) and the point at `depth` of the source's pixel (u, v), at most LARGEST_REPROJECTION."""
    if depth <= 0:
        return LARGEST_REPROJECTION
    px = depth * (u + np.float32(0.5) - pose[14]) / pose[12] - pose[9]
    py = depth * (v + np.float32(0.5) - pose[15]) / pose[13] - pose[10]
    pz = depth - pose[11]
    bz = pose[2] * px + pose[5] * py + pose[8] * pz
    if bz <= 0:
        return LARGEST_REPROJECTION
    bx = (pose[0] * px + pose[3] * py + pose[6] * pz) / bz - x
    by = (pose[1] * px + pose[4] * py + pose[7] * pz) / bz - y
    return min(LARGEST_REPROJECTION, np.sqrt(fx * fx * bx * bx + fy * fy * by * by))


@helper
def source_cost(x, y, depth, nx, ny, nz, fx, fy, sources, s, penalties, centred, weights, variance, level):
    """Return the matching cost of a plane in source s, 1 - NCC with the penalties added, or WORST_COST."""
    pose, first, height, width = sources.pose[s], sources.layout[s, 0], sources.layout[s, 1], sources.layout[s, 2]
    u, v, uc, ur, vc, vr = _warp(x, y, depth, nx, ny, nz, fx, fy, pose)
    reach = np.float32(PATCH_REACH * PATCH_SPACING)
    across, down = reach * (abs(uc) + abs(ur)), reach * (abs(vc) + abs(vr))
    area = abs(uc * vr - ur * vc)
    if not (_SMALLEST <= area <= _LARGEST) or across > WARPED_REACH or down > WARPED_REACH:
        return WORST_COST
    if u < across or v < down or u + across >= np.float32(width) - np.float32(1) or v + down >= np.float32(height) - np.float32(1):
        return WORST_COST
    nearest = np.uint32(first) + np.uint32(v + np.float32(0.5)) * np.uint32(width) + np.uint32(u + np.float32(0.5))
    if not sources.inside[nearest]:
        return WORST_COST
    cost = _correlate(sources.grey, first, width, u, v, uc, ur, vc, vr, centred, weights, variance, level, penalties.brightness)
    if penalties.reprojection > 0 and cost < WORST_COST:
        cost += penalties.reprojection * _reprojection_error(x, y, u, v, fx, fy, pose, sources.depth[nearest])
    return cost


@helper
def plane_cost(x, y, depth, nx, ny, nz, fx, fy, sources, asked, best, penalties, centred, weights, variance, level, costs):
    """Return the mean of the `best` lowest costs of a plane among the sources in the bit mask `asked`, and the mask of these sources."""
    count = sources.pose.shape[0]
    for s in range(count):
        costs[s] = WORST_COST
        if (asked >> s) & 1:
            costs[s] = source_cost(x, y, depth, nx, ny, nz, fx, fy, sources, s, penalties, centred, weights, variance, level)
    total, chosen = np.float32(0), 0
    for _ in range(best):
        least = -1
        for s in range(count):
            if not (chosen >> s) & 1 and (least < 0 or costs[s] < costs[least]):
                least = s
        chosen |= 1 << least
        total += costs[least]
    return total / np.float32(best), chosen
