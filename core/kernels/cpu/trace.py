# SPDX-License-Identifier: GPL-3.0-or-later
"""Ray tracer of 2D Gaussians in the exact order of hits: one ray at a time against 8 boxes, or 8 surfels, of a `SurfelTree`.

A ray keeps its NEAREST next hits in a sorted buffer, ordered by distance, then by the index of the Gaussian. Where the buffer
overflows before the ray is opaque, the traversal restarts behind the last hit: no hit is dropped or counted twice. Nodes wait on a stack,
the nearest on top; leaves are tested as soon as their box is, 8 surfels in parallel, since the buffer sorts the hits anyway.
"""

from __future__ import annotations

import math

import numpy as np

from ..constants import ALPHA_MAX, AXIS_U, AXIS_V, CUT, GRAZING, NORMAL, OPACITY, TRANSMITTANCE_MIN
from .bvh import LEAF, NODE
from .jit import helper, kernel
from .reductions import product
from .simd import bits, first_bit, load, maximum, minimum, select, splat, store
from .simd_math import exp

NEAREST = 48  # hits collected in one traversal
GROUP = 6  # nodes opened at once, which hides the latency of memory
_TINY = np.float32(1e-12)  # smallest magnitude of a component of a direction
_IN, _OUT = np.float32(1 - 1e-6), np.float32(1 + 1e-6)  # factors by which boxes are entered earlier, and left later, than computed
_NOBODY, _EVERYBODY = np.uint64(2**31 - 1), np.uint64(0x7F800000FFFFFFFF)  # sentinels that sort before and behind all hits
_NUMBER = np.uint64(2**32 - 1)
_SOLID = np.float32(0.9999 * TRANSMITTANCE_MIN)  # safely opaque despite the rounding of a product updated many times
_OPAQUE, _ZERO, _ONE, _FAR = np.float32(TRANSMITTANCE_MIN), np.float32(0.0), np.float32(1.0), np.float32(math.inf)


@helper
def _ray(origin, direction, ray):
    """Return a ray as vectors of equal lanes: origin, direction, and two inverse directions.

    These are rounded so that boxes are entered slightly too early and left slightly too late.
    """
    o = (splat(origin[3 * ray]), splat(origin[3 * ray + 1]), splat(origin[3 * ray + 2]))
    d = (direction[3 * ray], direction[3 * ray + 1], direction[3 * ray + 2])
    x, y, z = _inverse(d[0]), _inverse(d[1]), _inverse(d[2])
    into = (splat(x * _IN), splat(y * _IN), splat(z * _IN))
    out = (splat(x * _OUT), splat(y * _OUT), splat(z * _OUT))
    return o, (splat(d[0]), splat(d[1]), splat(d[2])), into, out


@helper
def _inverse(x):
    """Return 1 / x, with |x| clamped away from 0."""
    one = np.float32(1.0)
    return one / (x if abs(x) > _TINY else (-_TINY if x < 0 else _TINY))


@helper
def _sides(direction, ray):
    """Return, per axis, which half of a node holds the sides through which the ray enters: 0 the low ones, 24 the high ones."""
    x = 24 if direction[3 * ray] < 0 else 0
    y = 24 if direction[3 * ray + 1] < 0 else 0
    z = 24 if direction[3 * ray + 2] < 0 else 0
    return x, y, z


@helper
def _intersect_boxes(node, at, side, o, into, out):
    """Return the distances at which the ray enters and leaves a node's 8 boxes."""
    x0 = (load(node, at + side[0]) - o[0]) * into[0]
    y0 = (load(node, at + side[1] + 8) - o[1]) * into[1]
    z0 = (load(node, at + side[2] + 16) - o[2]) * into[2]
    x1 = (load(node, at + 24 - side[0]) - o[0]) * out[0]
    y1 = (load(node, at + 32 - side[1]) - o[1]) * out[1]
    z1 = (load(node, at + 40 - side[2]) - o[2]) * out[2]
    return maximum(maximum(x0, y0), maximum(z0, splat(_ZERO))), minimum(minimum(x1, y1), z1)


@helper
def _open(stack, top, node, side, ray, t_min, t_max, group, enters):
    """Take up to GROUP nodes off the stack; return its new top and a mask of the children hit, 8 bits per node.

    group: receives the nodes. enters: (8 GROUP,) receives the distances at which the ray enters their children.
    """
    o, _, into, out = ray
    children, k = np.uint64(0), 0
    while top > 0 and k < GROUP:
        top -= 1
        group[k] = stack[top]
        enter, leave = _intersect_boxes(node, group[k] * NODE, side, o, into, out)
        met = np.uint64(bits((enter <= leave) & (enter <= t_max) & (leave >= t_min)))
        children |= met << np.uint64(8 * k)
        store(enters, 8 * k, enter)
        k += 1
    return top, children


@helper
def _intersect_surfels(leaf, at, o, d):
    """Intersect the ray with a leaf's 8 surfels: return distance and rho in their planes, and a mask where that lies within the cut-off.

    All of it is computed at once: an early exit where no plane is hit would be mispredicted too often.
    """
    cx, cy, cz = load(leaf, at) - o[0], load(leaf, at + 8) - o[1], load(leaf, at + 16) - o[2]
    nx, ny, nz = load(leaf, at + NORMAL * 8), load(leaf, at + NORMAL * 8 + 8), load(leaf, at + NORMAL * 8 + 16)
    cosine = nx * d[0] + ny * d[1] + nz * d[2]
    t = (nx * cx + ny * cy + nz * cz) / cosine
    x, y, z = d[0] * t - cx, d[1] * t - cy, d[2] * t - cz
    at_u, at_v = at + AXIS_U * 8, at + AXIS_V * 8
    u = x * load(leaf, at_u) + y * load(leaf, at_u + 8) + z * load(leaf, at_u + 16)
    v = x * load(leaf, at_v) + y * load(leaf, at_v + 8) + z * load(leaf, at_v + 16)
    rho = u * u + v * v
    return t, rho, (cosine * cosine > GRAZING) & (rho <= load(leaf, at + CUT * 8))


@helper
def _alpha(leaf, at, rho):
    """Return the alpha of 8 surfels at rho."""
    return minimum(exp(rho * np.float32(-0.5)) * load(leaf, at + OPACITY * 8), splat(np.float32(ALPHA_MAX)))


@helper
def _hit(t, g):
    """Return a hit as one integer that sorts by distance, then by Gaussian."""
    return np.uint64(np.float32(t).view(np.uint32)) << np.uint64(32) | np.uint64(g)


@helper
def _distance(hit):
    """Return the distance of a hit made by `_hit`."""
    return np.uint32(hit >> np.uint64(32)).view(np.float32)


@helper
def _push(stack, stack_t, bottom, top, item, t):
    """Push a node on the stack, above those from `bottom` on that the ray enters later."""
    while top > bottom and stack_t[top - 1] < t:
        stack[top], stack_t[top] = stack[top - 1], stack_t[top - 1]
        top -= 1
    stack[top], stack_t[top] = item, t


@helper
def _insert(near, near_alpha, n, hit, alpha, behind):
    """Insert a hit into the n nearest; return their number and the transmittance behind them, without hits behind an opaque one."""
    place = n
    if n == NEAREST:
        place -= 1
        behind /= _ONE - near_alpha[place]
    else:
        n += 1
    while place > 0 and near[place - 1] > hit:
        near[place], near_alpha[place] = near[place - 1], near_alpha[place - 1]
        place -= 1
    near[place], near_alpha[place] = hit, alpha
    behind *= _ONE - alpha
    while n > 1 and behind <= _SOLID * (_ONE - near_alpha[n - 1]):
        n -= 1
        behind /= _ONE - near_alpha[n]
    return n, behind


@helper
def _nearest(ray, side, last, before, node, child, leaf, index, near, near_alpha, stack, stack_t, group, enters, lane_t, lane_alpha):
    """Find the next hits behind the hit `last`, where the transmittance is `before`.

    Writes near and near_alpha (NEAREST,), returns the number of hits.
    """
    o, d, _, _ = ray
    n, behind, furthest = 0, before, _EVERYBODY
    t_min, t_max = _distance(last), _FAR
    stack[0], stack_t[0], top = 0, _ZERO, 1
    while top > 0:
        if stack_t[top - 1] > t_max:
            top -= 1
            continue
        bottom, children = _open(stack, top, node, side, ray, t_min, t_max, group, enters)
        top = bottom
        while children != 0:
            lane = first_bit(children)
            children &= children - np.uint64(1)
            below = child[group[lane >> 3], lane & 7]
            if below >= 0:
                _push(stack, stack_t, bottom, top, below, enters[lane])
                top += 1
                continue
            t, rho, met = _intersect_surfels(leaf, ~below * LEAF, o, d)
            mask = bits(met & (t >= t_min) & (t <= t_max))
            if mask == 0:
                continue
            store(lane_t, 0, t)
            store(lane_alpha, 0, _alpha(leaf, ~below * LEAF, rho))
            while mask != 0:
                lane = first_bit(mask)
                mask &= mask - np.uint32(1)
                hit = _hit(lane_t[lane], index[~below * 8 + lane])
                if last < hit <= furthest:
                    n, behind = _insert(near, near_alpha, n, hit, lane_alpha[lane], behind)
                    if n == NEAREST or behind <= _SOLID:
                        furthest = near[n - 1]
            t_max = _distance(furthest)
    return n


@helper
def _grown(array):
    """Return a copy of an array with twice its capacity."""
    larger = np.empty(2 * len(array), array.dtype)
    for i in range(len(array)):  # numba would compile the words of an error for an assignment of slices
        larger[i] = array[i]
    return larger


@helper
def _stack_size(depth):
    """Return the capacity of the stack: opening groups off the top, each level of a tree leaves less than one group's children on it."""
    return 8 * GROUP * (depth + 1)


@kernel
def gather_range(begin, end, origin, direction, node, child, leaf, index, depth, count, left):
    """Trace rays begin..end; return Gaussian, weight and distance of their hits, (hits,) each, one ray after the other.

    origin, direction: (3 R,). count: (R,) receives the number of hits of each ray, left: (R,) the transmittance behind them. Weights are
    normalised to sum 1 where that is at most TRANSMITTANCE_MIN.
    """
    capacity = (end - begin) * 6 + NEAREST
    out_index, out_weight, out_t = np.empty(capacity, np.int32), np.empty(capacity, np.float32), np.empty(capacity, np.float32)
    near, near_alpha = np.empty(NEAREST, np.uint64), np.empty(NEAREST, np.float32)
    stack, stack_t = np.empty(_stack_size(depth), np.int32), np.empty(_stack_size(depth), np.float32)
    group, enters = np.empty(GROUP, np.int64), np.empty(8 * GROUP, np.float32)
    lane_t, lane_alpha = np.empty(8, np.float32), np.empty(8, np.float32)
    at = 0
    for i in range(begin, end):
        ray, side = _ray(origin, direction, i), _sides(direction, i)
        first, before, last, n = at, _ONE, _NOBODY, NEAREST
        while n == NEAREST and before > _OPAQUE:
            n = _nearest(
                ray, side, last, before, node, child, leaf, index, near, near_alpha, stack, stack_t, group, enters, lane_t, lane_alpha
            )  # fmt: skip
            if at + n > len(out_t):
                out_index, out_weight, out_t = _grown(out_index), _grown(out_weight), _grown(out_t)
            for j in range(n):
                if before <= _OPAQUE:
                    break
                last = near[j]
                out_index[at], out_t[at], out_weight[at] = np.int32(last & _NUMBER), _distance(last), before * near_alpha[j]
                before *= _ONE - near_alpha[j]
                at += 1
        if before <= _OPAQUE:
            for hit in range(first, at):
                out_weight[hit] /= _ONE - before
        count[i], left[i] = at - first, before
    return out_index[:at], out_weight[:at], out_t[:at]


@kernel
def transmittance_range(begin, end, origin, direction, node, child, leaf, depth, through):
    """Compute the transmittance of rays begin..end, through (R,), in any order of hits; 0 at or below TRANSMITTANCE_MIN."""
    stack, group, enters = np.empty(_stack_size(depth), np.int32), np.empty(GROUP, np.int64), np.empty(8 * GROUP, np.float32)
    one = splat(_ONE)
    for i in range(begin, end):
        ray, side = _ray(origin, direction, i), _sides(direction, i)
        o, d, _, _ = ray
        left, stack[0], top = _ONE, 0, 1
        while top > 0:
            top, children = _open(stack, top, node, side, ray, _ZERO, _FAR, group, enters)
            while children != 0:
                lane = first_bit(children)
                children &= children - np.uint64(1)
                below = child[group[lane >> 3], lane & 7]
                if below >= 0:
                    stack[top] = below
                    top += 1
                    continue
                t, rho, met = _intersect_surfels(leaf, ~below * LEAF, o, d)
                met = met & (t > _ZERO)
                if bits(met) == 0:
                    continue
                left *= product(select(met, one - _alpha(leaf, ~below * LEAF, rho), one))
                if left <= _OPAQUE:
                    left, top = _ZERO, 0
                    break
        through[i] = left
