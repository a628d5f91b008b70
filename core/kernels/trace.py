# SPDX-License-Identifier: GPL-3.0-or-later
"""Which 2D Gaussians a ray meets, in exact order: one ray at a time against 8 boxes, or 8 disks, of a `DiskTree`.

A ray keeps its NEAREST next hits in a sorted buffer, ordered by the true distance, then by the Gaussian's number. Where the buffer
overflows before the ray is opaque, it goes on from the last hit: nothing is dropped or met twice. Nodes wait on a stack, the nearest
on top; leaves are tested as soon as their box is, side by side for the processor, since the buffer sorts the hits anyway.
"""

from __future__ import annotations

import math

import numpy as np

from .bvh import AXIS_U, AXIS_V, CUT, LEAF, NODE, NORMAL, OPACITY
from .jit import kernel
from .raster import ALPHA_MAX, TRANSMITTANCE_MIN
from .simd import bits, exp, first_bit, load, maximum, minimum, product, select, splat, store

NEAREST = 32
GRAZING = 1e-8  # disks whose normal is this close (cosine squared) to square with the ray are missed
_TINY = np.float32(1e-12)  # directions' components are kept away from 0 by this
_IN, _OUT = np.float32(1 - 1e-6), np.float32(1 + 1e-6)  # boxes are entered this much earlier, and left this much later, than computed
_NOBODY, _EVERYBODY = np.uint64(2**31 - 1), np.uint64(0x7F800000FFFFFFFF)  # hits in front of and behind all others
_SOLID = 0.9999 * TRANSMITTANCE_MIN  # `behind`, multiplied and divided many times, is sure to be opaque below this
_NUMBER = np.uint64(2**32 - 1)


@kernel
def _ray(origin, direction, ray):
    """A ray as vectors of equal lanes: origin, direction, inverse directions rounded towards entering early and leaving late."""
    o = (splat(origin[3 * ray]), splat(origin[3 * ray + 1]), splat(origin[3 * ray + 2]))
    d = (direction[3 * ray], direction[3 * ray + 1], direction[3 * ray + 2])
    x, y, z = _inverse(d[0]), _inverse(d[1]), _inverse(d[2])
    into = (splat(x * _IN), splat(y * _IN), splat(z * _IN))
    out = (splat(x * _OUT), splat(y * _OUT), splat(z * _OUT))
    return o, (splat(d[0]), splat(d[1]), splat(d[2])), into, out


@kernel
def _inverse(x):
    one = np.float32(1.0)
    return one / (x if abs(x) > _TINY else (-_TINY if x < 0 else _TINY))


@kernel
def _sides(direction, ray):
    """Which half of a node, per axis, holds the sides through which the ray enters: 0 the low ones, 24 the high ones."""
    x = 24 if direction[3 * ray] < 0 else 0
    y = 24 if direction[3 * ray + 1] < 0 else 0
    z = 24 if direction[3 * ray + 2] < 0 else 0
    return x, y, z


@kernel
def _boxes(node, at, side, o, into, out):
    """Where the ray enters and leaves a node's 8 boxes."""
    x0 = (load(node, at + side[0]) - o[0]) * into[0]
    y0 = (load(node, at + side[1] + 8) - o[1]) * into[1]
    z0 = (load(node, at + side[2] + 16) - o[2]) * into[2]
    x1 = (load(node, at + 24 - side[0]) - o[0]) * out[0]
    y1 = (load(node, at + 32 - side[1]) - o[1]) * out[1]
    z1 = (load(node, at + 40 - side[2]) - o[2]) * out[2]
    return maximum(maximum(x0, y0), maximum(z0, splat(np.float32(0.0)))), minimum(minimum(x1, y1), z1)


@kernel
def _planes(leaf, at, o, d):
    """Where the ray meets the planes of a leaf's 8 disks: distance, whether squarely enough, and the centres from the origin."""
    cx, cy, cz = load(leaf, at) - o[0], load(leaf, at + 8) - o[1], load(leaf, at + 16) - o[2]
    nx, ny, nz = load(leaf, at + NORMAL * 8), load(leaf, at + NORMAL * 8 + 8), load(leaf, at + NORMAL * 8 + 16)
    cosine = nx * d[0] + ny * d[1] + nz * d[2]
    square = cosine * cosine > GRAZING
    t = (nx * cx + ny * cy + nz * cz) / select(square, cosine, splat(np.float32(1.0)))
    return t, square, (cx, cy, cz)


@kernel
def _bell(leaf, at, d, t, c):
    """rho = u^2 + v^2 of the hits at distances t."""
    x, y, z = d[0] * t - c[0], d[1] * t - c[1], d[2] * t - c[2]
    at_u, at_v = at + AXIS_U * 8, at + AXIS_V * 8
    u = x * load(leaf, at_u) + y * load(leaf, at_u + 8) + z * load(leaf, at_u + 16)
    v = x * load(leaf, at_v) + y * load(leaf, at_v + 8) + z * load(leaf, at_v + 16)
    return u * u + v * v


@kernel
def _alpha(leaf, at, rho):
    return minimum(exp(rho * np.float32(-0.5)) * load(leaf, at + OPACITY * 8), splat(np.float32(ALPHA_MAX)))


@kernel
def _hit(t, g):
    """A hit as one number that sorts by distance, then by Gaussian."""
    return np.uint64(np.float32(t).view(np.uint32)) << np.uint64(32) | np.uint64(g)


@kernel
def _distance(hit):
    """The distance of such a hit."""
    return np.uint32(hit >> np.uint64(32)).view(np.float32)


@kernel
def _grown(array):
    larger = np.empty(2 * len(array), array.dtype)
    larger[: len(array)] = array
    return larger


@kernel
def gather_range(begin, end, origin, direction, node, child, leaf, index, depth, count, left):
    """Follow rays begin..end: returns (hits,) Gaussian, weight and distance of their hits, one ray after the other.

    origin, direction: (3 R,). count: (R,) receives the hits of each ray, left: (R,) its transmittance behind them. Weights sum to
    1 where that is no more than TRANSMITTANCE_MIN.
    """
    capacity = (end - begin) * 6 + NEAREST
    out_index, out_weight, out_t = np.empty(capacity, np.int32), np.empty(capacity, np.float32), np.empty(capacity, np.float32)
    stack, stack_t = np.empty(7 * depth + 8, np.int32), np.empty(7 * depth + 8, np.float32)
    near, near_alpha = np.empty(NEAREST, np.uint64), np.empty(NEAREST, np.float32)
    lane_enter, lane_t, lane_alpha = np.empty(8, np.float32), np.empty(8, np.float32), np.empty(8, np.float32)
    opaque, solid = np.float32(TRANSMITTANCE_MIN), np.float32(_SOLID)
    at = 0
    for ray in range(begin, end):
        o, d, into, out = _ray(origin, direction, ray)
        side = _sides(direction, ray)
        first, before = at, np.float32(1.0)
        last_t, last = np.float32(0.0), _NOBODY
        while True:
            n, t_max, furthest, behind = 0, np.float32(math.inf), _EVERYBODY, before
            stack[0], stack_t[0], top = 0, np.float32(0.0), 1
            while top > 0:
                top -= 1
                if stack_t[top] > t_max:
                    continue
                item, bottom = stack[top], top
                enter, leave = _boxes(node, item * NODE, side, o, into, out)
                children = bits((enter <= leave) & (enter <= t_max) & (leave >= last_t))
                store(lane_enter, 0, enter)
                while children != 0:
                    lane = first_bit(children)
                    children &= children - np.uint32(1)
                    t, below = lane_enter[lane], child[item, lane]
                    if below >= 0:
                        place = top
                        while place > bottom and stack_t[place - 1] < t:  # the nearest child comes off first
                            stack[place], stack_t[place] = stack[place - 1], stack_t[place - 1]
                            place -= 1
                        stack[place], stack_t[place] = below, t
                        top += 1
                        continue
                    base = (~below) * LEAF
                    t8, square, centre = _planes(leaf, base, o, d)
                    met = square & (t8 >= last_t) & (t8 <= t_max)
                    if bits(met) == 0:
                        continue
                    rho = _bell(leaf, base, d, t8, centre)
                    mask = bits(met & (rho <= load(leaf, base + CUT * 8)))
                    if mask == 0:
                        continue
                    store(lane_t, 0, t8)
                    store(lane_alpha, 0, _alpha(leaf, base, rho))
                    while mask != 0:
                        lane = first_bit(mask)
                        mask &= mask - np.uint32(1)
                        key = _hit(lane_t[lane], index[(~below) * 8 + lane])
                        if key > furthest or key <= last:
                            continue
                        place = n
                        if n == NEAREST:
                            place -= 1
                            behind /= np.float32(1.0) - near_alpha[place]
                        else:
                            n += 1
                        while place > 0 and near[place - 1] > key:
                            near[place], near_alpha[place] = near[place - 1], near_alpha[place - 1]
                            place -= 1
                        near[place], near_alpha[place] = key, lane_alpha[lane]
                        behind *= np.float32(1.0) - lane_alpha[lane]
                        while n > 1 and behind <= solid * (np.float32(1.0) - near_alpha[n - 1]):  # nobody sees the last
                            n -= 1
                            behind /= np.float32(1.0) - near_alpha[n]
                        if n == NEAREST or behind <= solid:
                            furthest = near[n - 1]
                    t_max = _distance(furthest)
            if at + n > len(out_t):
                out_index, out_weight, out_t = _grown(out_index), _grown(out_weight), _grown(out_t)
            for i in range(n):
                weight = before * near_alpha[i]
                out_index[at], out_t[at], out_weight[at] = np.int32(near[i] & _NUMBER), _distance(near[i]), weight
                before *= np.float32(1.0) - near_alpha[i]
                at += 1
                if before <= opaque:
                    break
            if n < NEAREST or before <= opaque:
                break
            last = near[n - 1]
            last_t = _distance(last)
        if before <= opaque:
            scale = np.float32(1.0) / (np.float32(1.0) - before)
            for i in range(first, at):
                out_weight[i] *= scale
        count[ray], left[ray] = at - first, before
    return out_index[:at].copy(), out_weight[:at].copy(), out_t[:at].copy()


@kernel
def transmittance_range(begin, end, origin, direction, node, child, leaf, depth, through):
    """What passes through along rays begin..end -> through (R,); in any order, and no further than to TRANSMITTANCE_MIN."""
    stack = np.empty(7 * depth + 8, np.int32)
    zero, one = splat(np.float32(0.0)), splat(np.float32(1.0))
    for ray in range(begin, end):
        o, d, into, out = _ray(origin, direction, ray)
        side = _sides(direction, ray)
        left = np.float32(1.0)
        stack[0], top = 0, 1
        while top > 0:
            top -= 1
            item = stack[top]
            enter, leave = _boxes(node, item * NODE, side, o, into, out)
            children = bits(enter <= leave)
            while children != 0:
                below = child[item, first_bit(children)]
                children &= children - np.uint32(1)
                if below >= 0:
                    stack[top] = below
                    top += 1
                    continue
                base = (~below) * LEAF
                t, square, centre = _planes(leaf, base, o, d)
                met = square & (t > zero)
                if bits(met) == 0:
                    continue
                rho = _bell(leaf, base, d, t, centre)
                met = met & (rho <= load(leaf, base + CUT * 8))
                if bits(met) == 0:
                    continue
                left *= product(select(met, one - _alpha(leaf, base, rho), one))
                if left <= np.float32(TRANSMITTANCE_MIN):
                    left, top = np.float32(0.0), 0
                    break
        through[ray] = left
