# SPDX-License-Identifier: GPL-3.0-or-later
"""Rays through 2D Gaussians on the GPU, a thread per ray, in the exact order of hits; definitions are in core/kernels/cpu/trace.py."""

from functools import cache
from typing import Any

import warp as wp

from ..constants import (
    ALPHA_MIN,
    AXIS_U,
    AXIS_V,
    BEHIND,
    CUT,
    NORMAL,
    OPACITY,
    SCALE_RANGE,
    SCALE_U,
    SCALE_V,
    TRANSMITTANCE_MIN,
)
from .harmonics import Basis, basis, normal_of, tangent_u, tangent_v, unit_quaternion
from .next_hits import BEFORE_ALL, NEAREST, distance_of, meet, next_hits, number_of, safe, triple

_NEAREST = wp.constant(NEAREST)
_BEHIND = wp.constant(BEHIND)
_N, _U, _V, _O, _CUT = wp.constant(NORMAL), wp.constant(AXIS_U), wp.constant(AXIS_V), wp.constant(OPACITY), wp.constant(CUT)
_SU, _SV = wp.constant(SCALE_U), wp.constant(SCALE_V)
_SMALLEST, _LARGEST = wp.constant(SCALE_RANGE[0]), wp.constant(SCALE_RANGE[1])
_PAD = wp.constant(4.0e-6)  # boxes grow by this fraction of their position and 10 times this of their size, against rounding
_FAR = wp.constant(3.0e38)
_ALPHA_MIN, _OPAQUE = wp.constant(ALPHA_MIN), wp.constant(TRANSMITTANCE_MIN)


@wp.kernel
def describe(
    position: wp.array(dtype=float), quaternion: wp.array(dtype=float), log_scale: wp.array(dtype=float), opacity: wp.array(dtype=float),
    n: int, record: wp.array2d(dtype=float), lower: wp.array(dtype=wp.vec3), upper: wp.array(dtype=wp.vec3),
):  # fmt: skip
    """Write records (core/kernels/cpu/bvh.py) and boxes of all surfels; where nothing can be hit, CUT is -1 and the box a point."""
    i = wp.tid()
    c = wp.vec3(position[i], position[n + i], position[2 * n + i])
    q = unit_quaternion(wp.vec4(quaternion[i], quaternion[n + i], quaternion[2 * n + i], quaternion[3 * n + i]))
    u, v, normal = tangent_u(q), tangent_v(q), normal_of(q)
    su, sv = wp.exp(log_scale[i]), wp.exp(log_scale[n + i])
    alpha = 1.0 / (1.0 + wp.exp(-opacity[i]))
    valid = alpha > _ALPHA_MIN and _SMALLEST < su and su < _LARGEST and _SMALLEST < sv and sv < _LARGEST
    for axis in range(3):
        valid = valid and wp.abs(c[axis]) < _LARGEST and wp.abs(normal[axis]) < 2.0
    cut = float(-1.0)
    if valid:
        cut = 2.0 * wp.log(alpha / _ALPHA_MIN)
    radius = wp.sqrt(wp.max(cut, 0.0))
    half = radius * wp.max(su, sv)
    low, high = wp.vec3(0.0, 0.0, 0.0), wp.vec3(0.0, 0.0, 0.0)
    for axis in range(3):
        record[i, axis] = c[axis]
        record[i, _N + axis] = normal[axis]
        record[i, _U + axis] = u[axis] / su
        record[i, _V + axis] = v[axis] / sv
        if valid:
            wide = radius * wp.sqrt((su * u[axis]) * (su * u[axis]) + (sv * v[axis]) * (sv * v[axis]))
            wide += _PAD * (wp.abs(c[axis]) + 10.0 * half)
            low[axis] = c[axis] - wide
            high[axis] = c[axis] + wide
    record[i, _O] = alpha
    record[i, _CUT] = cut
    record[i, _SU] = su
    record[i, _SV] = sv
    lower[i] = low
    upper[i] = high


@wp.func
def facing(normal: wp.vec3, d: wp.vec3) -> float:
    """Return 1, or -1 where the ray meets a surfel from behind, so that its normal is flipped."""
    return wp.where(wp.dot(normal, d) > _BEHIND, -1.0, 1.0)


@wp.func
def shown(b: Basis, rows: wp.array(dtype=float), at: int, coefficients: int) -> float:
    """Return one channel of a Gaussian's radiance before its clamp; its coefficients start at rows[at]."""
    value = float(0.5)
    for j in range(16):
        if j < coefficients:
            value += b[j] * rows[at + j]
    return value


@cache
def composite(extras: int) -> Any:
    """Return the kernel that traces and composites rays, for a number of further channels."""
    Row = wp.types.vector(length=max(extras, 1), dtype=wp.float32)
    count = extras

    @wp.kernel(module="unique")
    def see(
        nodes: wp.array(dtype=wp.vec4), items: wp.array(dtype=int), record: wp.array2d(dtype=float),
        origin: wp.array(dtype=wp.vec3), direction: wp.array(dtype=wp.vec3),
        sh: wp.array(dtype=float), coefficients: int, extra: wp.array(dtype=float), out: wp.array2d(dtype=float),
        hits_of: wp.array(dtype=wp.int64), left: wp.array(dtype=float),
    ):  # fmt: skip
        """Write sums (R, 8 + E), number of hits (R,) and transmittance (R,) of rays; rows of Gaussians: sh (N, 3 K), extra (N, E)."""
        ray = wp.tid()
        o, d = origin[ray], direction[ray]
        b = basis(d, coefficients)
        colour, normal, acc, depth, before = wp.vec3(0.0, 0.0, 0.0), wp.vec3(0.0, 0.0, 0.0), Row(0.0), float(0.0), float(1.0)
        last, n, total = wp.uint64(BEFORE_ALL), int(_NEAREST), int(0)
        while n == _NEAREST and before > _OPAQUE:
            n, hits, alphas = next_hits(nodes, items, record, o, d, last, before)
            for k in range(n):
                if before <= _OPAQUE:
                    break
                last = hits[k]
                g, weight = number_of(last), before * alphas[k]
                before *= 1.0 - alphas[k]
                total += 1
                if coefficients > 0:
                    for channel in range(3):
                        value = shown(b, sh, (g * 3 + channel) * coefficients, coefficients)
                        colour[channel] += weight * wp.max(value, 0.0)
                surfel_normal = triple(record, g, _N)
                normal += surfel_normal * (weight * facing(surfel_normal, d))
                for j in range(count):
                    acc[j] += weight * extra[g * count + j]
                depth += weight * distance_of(last)
        opaque = before <= _OPAQUE
        scale = wp.where(opaque, 1.0 / (1.0 - before), 1.0)
        for axis in range(3):
            out[ray, axis] = colour[axis] * scale
            out[ray, 3 + axis] = normal[axis] * scale
        for j in range(count):
            out[ray, 6 + j] = acc[j] * scale
        out[ray, 6 + count] = depth * scale
        out[ray, 7 + count] = wp.where(opaque, 1.0, 1.0 - before)
        hits_of[ray] = wp.int64(total)
        left[ray] = before

    return see


@wp.kernel
def gather(
    nodes: wp.array(dtype=wp.vec4), items: wp.array(dtype=int), record: wp.array2d(dtype=float),
    origin: wp.array(dtype=wp.vec3), direction: wp.array(dtype=wp.vec3),
    start: wp.array(dtype=wp.int64), index: wp.array(dtype=int), weight: wp.array(dtype=float), distance: wp.array(dtype=float),
    of: wp.array(dtype=int),
):  # fmt: skip
    """Write the hits of each ray r to start[r]..start[r + 1], counted before; of: (H,) ray of each hit."""
    ray = wp.tid()
    if start[ray] == start[ray + 1]:
        return
    o, d = origin[ray], direction[ray]
    first = int(start[ray])
    last, n, at, before = wp.uint64(BEFORE_ALL), int(_NEAREST), int(first), float(1.0)
    while n == _NEAREST and before > _OPAQUE:
        n, hits, alphas = next_hits(nodes, items, record, o, d, last, before)
        for k in range(n):
            if before <= _OPAQUE:
                break
            last = hits[k]
            index[at] = number_of(last)
            distance[at] = distance_of(last)
            weight[at] = before * alphas[k]
            of[at] = ray
            before *= 1.0 - alphas[k]
            at += 1
    if before <= _OPAQUE:
        for hit in range(first, at):
            weight[hit] = weight[hit] / (1.0 - before)


@wp.kernel
def pass_through(
    tree: wp.uint64, record: wp.array2d(dtype=float), origin: wp.array(dtype=wp.vec3), direction: wp.array(dtype=wp.vec3),
    through: wp.array(dtype=float),
):  # fmt: skip
    """Compute the transmittance of each ray, (R,), in any order of hits; 0 at or below TRANSMITTANCE_MIN."""
    ray = wp.tid()
    o, d = origin[ray], direction[ray]
    left, g = float(1.0), int(0)
    query = wp.bvh_query_ray(tree, o, safe(d))
    while wp.bvh_query_next(query, g, _FAR):
        met = meet(record, g, o, d)
        if met[0] > 0.0:
            left *= 1.0 - met[1]
            if left <= _OPAQUE:
                left = 0.0
                break
    through[ray] = left


@wp.kernel
def blend(
    ray: wp.array(dtype=wp.int64), start: wp.array(dtype=wp.int64), index: wp.array(dtype=int), weight: wp.array(dtype=float),
    values: wp.array2d(dtype=float), out: wp.array2d(dtype=float),
):  # fmt: skip
    """Sum values (C, N) over the hits of chosen rays to out (B, C)."""
    b, channel = wp.tid()
    total = float(0.0)
    for hit in range(int(start[ray[b]]), int(start[ray[b] + wp.int64(1)])):
        total += weight[hit] * values[channel, index[hit]]
    out[b, channel] = total
