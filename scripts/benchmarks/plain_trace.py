# SPDX-License-Identifier: GPL-3.0-or-later
"""Ray tracer of surfels in plain scalar loops, for comparison with `core/kernels/cpu/trace.py` and its vector type."""

from __future__ import annotations

import math

import numpy as np
from irgspp.core.kernels.constants import ALPHA_MAX, AXIS_U, AXIS_V, CUT, GRAZING, NORMAL, OPACITY, TRANSMITTANCE_MIN
from irgspp.core.kernels.cpu.bvh import LEAF, NODE
from irgspp.core.kernels.cpu.compositing import SH_ROW, spread_basis
from irgspp.core.kernels.cpu.jit import helper, kernel
from irgspp.core.kernels.cpu.trace import (
    _EVERYBODY,
    _IN,
    _NOBODY,
    _NUMBER,
    _OUT,
    _SOLID,
    NEAREST,
    _distance,
    _grown,
    _hit,
    _insert,
    _inverse,
    _push,
)

_ONE, _ZERO, _HALF, _FAR = np.float32(1.0), np.float32(0.0), np.float32(0.5), np.float32(math.inf)
_STOP, _MAX, _GRAZING = np.float32(TRANSMITTANCE_MIN), np.float32(ALPHA_MAX), np.float32(GRAZING)


@helper
def _box(node, at, lane, o, inv):
    """Return the distances at which a ray enters and leaves one box of a node."""
    enter, leave = _ZERO, _FAR
    for axis in range(3):
        near = node[at + axis * 8 + lane + (24 if inv[axis] < 0 else 0)]
        far = node[at + axis * 8 + lane + (0 if inv[axis] < 0 else 24)]
        enter = max(enter, (near - o[axis]) * inv[axis] * _IN)
        leave = min(leave, (far - o[axis]) * inv[axis] * _OUT)
    return enter, leave


@helper
def _surfel(leaf, at, o, d, first, last):
    """Return distance and alpha of the hit with one surfel of a leaf, alpha 0 where there is none between `first` and `last`."""
    n = at + NORMAL * 8
    cosine = leaf[n] * d[0] + leaf[n + 8] * d[1] + leaf[n + 16] * d[2]
    if not cosine * cosine > _GRAZING:
        return _ZERO, _ZERO
    cx, cy, cz = leaf[at] - o[0], leaf[at + 8] - o[1], leaf[at + 16] - o[2]
    t = (leaf[n] * cx + leaf[n + 8] * cy + leaf[n + 16] * cz) / cosine
    if not first <= t <= last:
        return _ZERO, _ZERO
    x, y, z = d[0] * t - cx, d[1] * t - cy, d[2] * t - cz
    a, b = at + AXIS_U * 8, at + AXIS_V * 8
    u = x * leaf[a] + y * leaf[a + 8] + z * leaf[a + 16]
    v = x * leaf[b] + y * leaf[b + 8] + z * leaf[b + 16]
    rho = u * u + v * v
    if not rho <= leaf[at + CUT * 8]:
        return _ZERO, _ZERO
    return t, min(np.float32(math.exp(-_HALF * rho)) * leaf[at + OPACITY * 8], _MAX)


@helper
def _plain_nearest(o, d, inv, last, before, node, child, leaf, index, near, near_alpha, stack, stack_t):
    """Collect the nearest hits behind `last`, up to NEAREST, and return their number."""
    n, behind, furthest = 0, before, _EVERYBODY
    t_min, t_max = _distance(last), _FAR
    stack[0], stack_t[0], top = 0, _ZERO, 1
    while top > 0:
        top -= 1
        if stack_t[top] > t_max:
            continue
        item, bottom = stack[top], top
        for lane in range(8):
            enter, leave = _box(node, item * NODE, lane, o, inv)
            if not (enter <= leave and enter <= t_max and leave >= t_min):
                continue
            below = child[item, lane]
            if below >= 0:
                _push(stack, stack_t, bottom, top, below, enter)
                top += 1
                continue
            for surfel in range(8):
                t, alpha = _surfel(leaf, ~below * LEAF + surfel, o, d, t_min, t_max)
                if alpha == 0:
                    continue
                hit = _hit(t, index[~below * 8 + surfel])
                if last < hit <= furthest:
                    n, behind = _insert(near, near_alpha, n, hit, alpha, behind)
                    if n == NEAREST or behind <= _SOLID:
                        furthest = near[n - 1]
                        t_max = _distance(furthest)
    return n


@kernel
def plain_gather_range(begin, end, origin, direction, node, child, leaf, index, depth, count, left):
    """Return the hits of a range of rays as `gather_range` does, one box and one surfel at a time: index, weight and distance (hits,)."""
    capacity = (end - begin) * 6 + NEAREST
    out_index, out_weight, out_t = np.empty(capacity, np.int32), np.empty(capacity, np.float32), np.empty(capacity, np.float32)
    near, near_alpha = np.empty(NEAREST, np.uint64), np.empty(NEAREST, np.float32)
    stack, stack_t = np.empty(7 * depth + 8, np.int32), np.empty(7 * depth + 8, np.float32)
    at = 0
    for ray in range(begin, end):
        o = (origin[3 * ray], origin[3 * ray + 1], origin[3 * ray + 2])
        d = (direction[3 * ray], direction[3 * ray + 1], direction[3 * ray + 2])
        inv = (_inverse(d[0]), _inverse(d[1]), _inverse(d[2]))
        first, before, last, n = at, _ONE, _NOBODY, NEAREST
        while n == NEAREST and before > _STOP:
            n = _plain_nearest(o, d, inv, last, before, node, child, leaf, index, near, near_alpha, stack, stack_t)
            if at + n > len(out_t):
                out_index, out_weight, out_t = _grown(out_index), _grown(out_weight), _grown(out_t)
            for j in range(n):
                if before <= _STOP:
                    break
                last = near[j]
                out_index[at], out_t[at], out_weight[at] = np.int32(last & _NUMBER), _distance(last), before * near_alpha[j]
                before *= _ONE - near_alpha[j]
                at += 1
        if before <= _STOP:
            for hit in range(first, at):
                out_weight[hit] /= _ONE - before
        count[ray], left[ray] = at - first, before
    return out_index[:at], out_weight[:at], out_t[:at]


@kernel
def plain_composite_range(begin, end, direction, start, index, weight, distance, left, record, rows, coefficients, extras, out, lit):
    """Composite the hits of a range of rays into `out` (R, channels) as `composite_range` does, one number at a time."""
    offset = SH_ROW if coefficients > 0 else 0
    axes, values, spread = np.zeros(24, np.float32), np.zeros(128, np.float32), np.zeros(128, np.float32)
    block = -1
    for ray in range(begin, end):
        out[ray] = _ZERO
        if start[ray] == start[ray + 1]:
            continue
        lane = (ray - begin) % 8
        if coefficients > 0 and ray - lane != block:
            block = ray - lane
            spread_basis(direction, block, end, coefficients, axes, values, spread)
        d = (direction[3 * ray], direction[3 * ray + 1], direction[3 * ray + 2])
        for hit in range(start[ray], start[ray + 1]):
            g, w = index[hit], weight[hit]
            lit[hit] = 0
            if coefficients > 0:
                for channel in range(3):
                    value = _HALF
                    for j in range(16):
                        value += rows[g, channel * 16 + j] * spread[lane * 16 + j]
                    if value > 0:
                        lit[hit] |= 1 << channel
                        out[ray, channel] += w * value
            cosine = record[g, NORMAL] * d[0] + record[g, NORMAL + 1] * d[1] + record[g, NORMAL + 2] * d[2]
            for axis in range(3):
                out[ray, 3 + axis] += record[g, NORMAL + axis] * (-w if cosine > 0 else w)
            for j in range(extras):
                out[ray, 6 + j] += rows[g, offset + j] * w
            out[ray, 6 + extras] += w * distance[hit]
            out[ray, 7 + extras] += w
        if left[ray] <= _STOP:
            out[ray, 7 + extras] = _ONE


@kernel
def plain_composite_backward_range(slot, begin, end, direction, start, index, weight, lit, coefficients, extras, gradient, slots):
    """Add the gradients of a range of rays to `slots` (slots, N, channels) as `composite_backward_range` does, one number at a time."""
    out = slots[slot]
    offset = SH_ROW if coefficients > 0 else 0
    axes, values, spread = np.zeros(24, np.float32), np.zeros(128, np.float32), np.zeros(128, np.float32)
    block = -1
    for ray in range(begin, end):
        if start[ray] == start[ray + 1]:
            continue
        lane = (ray - begin) % 8
        if coefficients > 0 and ray - lane != block:
            block = ray - lane
            spread_basis(direction, block, end, coefficients, axes, values, spread)
        for hit in range(start[ray], start[ray + 1]):
            g, w = index[hit], weight[hit]
            for channel in range(3):
                if lit[hit] >> channel & 1 and coefficients > 0:
                    share = w * gradient[ray, channel]
                    for j in range(16):
                        out[g, channel * 16 + j] += spread[lane * 16 + j] * share
            for j in range(extras):
                out[g, offset + j] += w * gradient[ray, 6 + j]
