# SPDX-License-Identifier: GPL-3.0-or-later
"""PatchMatch stereo with slanted planes (Bleyer et al. 2011): every pixel takes over good planes of its neighbours and varies its own.

One call sweeps over one view in one thread, in place, so that a good plane crosses the image in a single sweep.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ..kernels.constants import FLAT_VARIANCE, PATCH_SAMPLES, WORST_COST
from ..kernels.cpu.jit import helper, kernel
from ..kernels.cpu.matching_cost import Penalties, Sources, plane_cost, read_patch

# Planes that a sweep tries at a pixel: of two neighbours, with another depth, with another normal, with both
BESIDE, ABOVE, OTHER_DEPTH, OTHER_NORMAL, OTHER_PLANE = range(5)
MAX_USABLE_COSINE = np.float32(-0.05)  # normal . (x, y, 1) above which a plane is too nearly edge-on
MAX_VARIED_COSINE = np.float32(-0.15)  # cosine of normal and ray below which a varied normal is accepted
SAME_DEPTH, SAME_NORMAL = np.float32(1e-4), np.float32(0.9995)  # relative difference, cosine: planes that need no second look
HOPELESS_COST = np.float32(0.6)  # cost above which any depth within the bounds may be drawn
DEPTH_STEP = np.float32(0.02)  # largest relative change of a depth at step 1
NORMAL_STEP = np.float32(0.8)  # largest change of each component of a normal at step 1
JOINT_DEPTH_STEP, JOINT_NORMAL_STEP = np.float32(0.005), np.float32(0.25)  # largest changes at step 1 where depth and normal change


class Reference(NamedTuple):
    """View whose planes are searched.

    Attributes:
        grey: (H, W) float32 grey values in 0..1.
        inside: (H, W) bool, True on the object.
        lens: (4,) float32 fx, fy, cx, cy.
    """

    grey: np.ndarray
    inside: np.ndarray
    lens: np.ndarray


class Matching(NamedTuple):
    """How planes are compared.

    Attributes:
        sources: the views that the reference is matched with.
        best: number of sources with the lowest cost that count.
        penalties: what is added to 1 - NCC.
        inverse_sigma: float32, 1 / the difference of grey values at which a sample's weight has fallen to 1 / e.
    """

    sources: Sources
    best: int
    penalties: Penalties
    inverse_sigma: np.float32


@helper
def _uniform(state):
    """Draw from 0..1 by xorshift32 (Marsaglia 2003); state (1,) uint32, not 0. numpy's generator would take three times as long."""
    s = state[0]
    s ^= np.uint32(s << np.uint32(13))
    s ^= np.uint32(s >> np.uint32(17))
    s ^= np.uint32(s << np.uint32(5))
    state[0] = s
    return np.float32(np.uint32(s) >> np.uint32(8)) * np.float32(2.0**-24)


@helper
def _signed(state):
    """Draw from -1..1."""
    return np.float32(2) * _uniform(state) - np.float32(1)


@helper
def _varied_normal(x, y, nx, ny, nz, amount, state):
    """Vary a unit normal, and return it as it is where it would turn away from the camera along the ray (x, y, 1)."""
    mx, my, mz = nx + amount * _signed(state), ny + amount * _signed(state), nz + amount * _signed(state)
    scale = np.float32(1) / np.sqrt(mx * mx + my * my + mz * mz)
    mx, my, mz = mx * scale, my * scale, mz * scale
    if mx * x + my * y + mz < MAX_VARIED_COSINE * np.sqrt(x * x + y * y + np.float32(1)):
        return mx, my, mz
    return nx, ny, nz


@helper
def _ray(row, column, lens):
    """Return x and y of the ray (x, y, 1) through a pixel's centre."""
    return (np.float32(column) + np.float32(0.5) - lens[2]) / lens[0], (np.float32(row) + np.float32(0.5) - lens[3]) / lens[1]


@helper
def _depth_of_plane(depth, normal, row, column, x, y, lens):
    """Return the depth at which the ray (x, y, 1) meets the plane of a pixel, 0 where it has none or is seen edge-on."""
    if not (0 <= row < depth.shape[0] and 0 <= column < depth.shape[1]):
        return np.float32(0)
    nx, ny, nz = normal[row, column, 0], normal[row, column, 1], normal[row, column, 2]
    along = nx * x + ny * y + nz
    if along > MAX_USABLE_COSINE:
        return np.float32(0)
    px, py = _ray(row, column, lens)
    return depth[row, column] * (nx * px + ny * py + nz) / along


@helper
def _plane_at(depth, normal, row, column):
    """Return the plane of a pixel: its depth and the components of its normal."""
    return depth[row, column], normal[row, column, 0], normal[row, column, 1], normal[row, column, 2]


@helper
def _is_same_plane(plane, other):
    """Return True where two planes differ so little that the other needs no second look."""
    cosine = other[1] * plane[1] + other[2] * plane[2] + other[3] * plane[3]
    return abs(other[0] - plane[0]) < SAME_DEPTH * plane[0] and cosine > SAME_NORMAL


@helper
def _varied_plane(trial, plane, x, y, cost, low, high, step, state):
    """Vary the plane of a cost at the ray (x, y, 1); where the cost is hopeless, its depth may be any from low to high."""
    d, nx, ny, nz = plane
    if trial == OTHER_DEPTH and cost > HOPELESS_COST:
        d = np.float32(1) / (np.float32(1) / high + (np.float32(1) / low - np.float32(1) / high) * _uniform(state))
    elif trial == OTHER_DEPTH:
        d = d * (np.float32(1) + DEPTH_STEP * step * _signed(state))
    elif trial == OTHER_NORMAL:
        nx, ny, nz = _varied_normal(x, y, nx, ny, nz, NORMAL_STEP * step, state)
    else:
        d = d * (np.float32(1) + JOINT_DEPTH_STEP * step * _signed(state))
        nx, ny, nz = _varied_normal(x, y, nx, ny, nz, JOINT_NORMAL_STEP * step, state)
    return d, nx, ny, nz


@kernel
def evaluate(reference, matching, planes, only_chosen):
    """Compute the cost of all `Planes` and the bit masks of their best sources, among all or those chosen so far.

    Pixels with depth 0 are left as they are; where a patch has no texture the cost is WORST_COST.
    """
    grey, inside, lens = reference
    sources, best, penalties, inverse_sigma = matching
    depth, normal, cost, chosen = planes
    count = sources.pose.shape[0]
    centred, weights, costs = np.empty(PATCH_SAMPLES, np.float32), np.empty(PATCH_SAMPLES, np.float32), np.empty(count, np.float32)
    for row in range(grey.shape[0]):
        for column in range(grey.shape[1]):
            if depth[row, column] <= 0:
                continue
            cost[row, column] = WORST_COST
            variance, level = read_patch(grey, inside, row, column, inverse_sigma, centred, weights)
            if variance < FLAT_VARIANCE:
                continue
            x, y = _ray(row, column, lens)
            d, nx, ny, nz = _plane_at(depth, normal, row, column)
            asked = chosen[row, column] if only_chosen else (1 << count) - 1
            cost[row, column], chosen[row, column] = plane_cost(
                x, y, d, nx, ny, nz, lens[0], lens[1], sources, asked, best, penalties, centred, weights, variance, level, costs
            )


@kernel
def sweep(reference, nearest, farthest, matching, planes, backwards, step, seed):
    """Sweep once over a view, from the upper left or backwards, and improve its `Planes` in place.

    Every trial asks the chosen sources and one more at random (two sets, at a neighbour's plane). `step` scales random changes.
    `nearest` and `farthest` (H, W) bound the depths; pixels with depth 0 are left alone.
    """
    grey, inside, lens = reference
    sources, best, penalties, inverse_sigma = matching
    depth, normal, cost, chosen = planes
    height, width = grey.shape
    count = sources.pose.shape[0]
    centred, weights, costs = np.empty(PATCH_SAMPLES, np.float32), np.empty(PATCH_SAMPLES, np.float32), np.empty(count, np.float32)
    state = np.array([seed], np.uint32)
    toward = 1 if backwards else -1  # the pixels that were just swept
    for i in range(height):
        row = height - 1 - i if backwards else i
        for j in range(width):
            column = width - 1 - j if backwards else j
            if depth[row, column] <= 0:
                continue
            variance, level = read_patch(grey, inside, row, column, inverse_sigma, centred, weights)
            if variance < FLAT_VARIANCE:
                continue
            x, y = _ray(row, column, lens)
            low, high = nearest[row, column], farthest[row, column]
            d, nx, ny, nz = _plane_at(depth, normal, row, column)
            least, own = cost[row, column], chosen[row, column]
            for trial in range(OTHER_PLANE + 1):
                td, tx, ty, tz = d, nx, ny, nz
                asked = own | 1 << int(_uniform(state) * np.float32(count))
                if trial < OTHER_DEPTH:
                    r, c = (row, column + toward) if trial == BESIDE else (row + toward, column)
                    td = _depth_of_plane(depth, normal, r, c, x, y, lens)
                    if td <= 0:
                        continue
                    tx, ty, tz = normal[r, c, 0], normal[r, c, 1], normal[r, c, 2]
                    if _is_same_plane((d, nx, ny, nz), (td, tx, ty, tz)):
                        continue
                    if cost[r, c] < least:
                        asked = own | chosen[r, c]
                else:
                    td, tx, ty, tz = _varied_plane(trial, (d, nx, ny, nz), x, y, least, low, high, step, state)
                if not (low <= td <= high):
                    continue
                other, found = plane_cost(
                    x, y, td, tx, ty, tz, lens[0], lens[1], sources, asked, best, penalties, centred, weights, variance, level, costs
                )
                if other < least:
                    least, own, d, nx, ny, nz = other, found, td, tx, ty, tz
            cost[row, column], chosen[row, column], depth[row, column] = least, own, d
            normal[row, column, 0], normal[row, column, 1], normal[row, column, 2] = nx, ny, nz
