# SPDX-License-Identifier: GPL-3.0-or-later
"""Rays through 2D Gaussians on the GPU, a thread per ray, in the exact order of hits; definitions are in core/kernels/cpu/trace.py.

Warp's tree returns boxes in any order. A ray keeps its NEAREST next hits sorted by distance, then by the index of the Gaussian, and
restarts behind the last of them where they do not make it opaque: no hit is dropped or counted twice.
"""

from functools import cache
from typing import Any

import warp as wp

from ..constants import (
    ALPHA_MAX,
    ALPHA_MIN,
    AXIS_U,
    AXIS_V,
    BEHIND,
    CUT,
    GRAZING,
    NORMAL,
    OPACITY,
    SCALE_RANGE,
    SCALE_U,
    SCALE_V,
    TRANSMITTANCE_MIN,
)
from .harmonics import Basis, basis, normal_of, tangent_u, tangent_v, unit_quaternion

NEAREST = 16  # hits collected in one traversal
_NEAREST = wp.constant(NEAREST)
_BEHIND = wp.constant(BEHIND)
_N, _U, _V, _O, _CUT = wp.constant(NORMAL), wp.constant(AXIS_U), wp.constant(AXIS_V), wp.constant(OPACITY), wp.constant(CUT)
_SU, _SV = wp.constant(SCALE_U), wp.constant(SCALE_V)
_SMALLEST, _LARGEST = wp.constant(SCALE_RANGE[0]), wp.constant(SCALE_RANGE[1])
_PAD = wp.constant(4.0e-6)  # boxes grow by this fraction of their position and 10 times this of their size, against rounding
_TINY = wp.constant(1.0e-12)  # smallest magnitude of a component of a direction
_FAR = wp.constant(3.0e38)
_ALPHA_MIN, _ALPHA_MAX, _OPAQUE, _GRAZING = (
    wp.constant(ALPHA_MIN),
    wp.constant(ALPHA_MAX),
    wp.constant(TRANSMITTANCE_MIN),
    wp.constant(GRAZING),
)
_SOLID = wp.constant(0.9999 * TRANSMITTANCE_MIN)  # safely opaque despite the rounding of a product updated many times
_BEFORE_ALL, _BEHIND_ALL = wp.constant(wp.uint64(2**31 - 1)), wp.constant(wp.uint64(0x7F7FFFFFFFFFFFFF))  # sort before and behind all

Hits = wp.types.vector(length=NEAREST, dtype=wp.uint64)
Alphas = wp.types.vector(length=NEAREST, dtype=wp.float32)


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
def triple(record: wp.array2d(dtype=float), g: int, column: int) -> wp.vec3:
    """Return three columns of surfel g's record as a vector."""
    return wp.vec3(record[g, column], record[g, column + 1], record[g, column + 2])


@wp.func
def safe(d: wp.vec3) -> wp.vec3:
    """Return a direction with components clamped away from 0, for the division in box tests."""
    out = d
    for axis in range(3):
        if wp.abs(d[axis]) < _TINY:
            out[axis] = wp.where(d[axis] < 0.0, -_TINY, _TINY)
    return out


@wp.func
def meet(record: wp.array2d(dtype=float), g: int, o: wp.vec3, d: wp.vec3) -> wp.vec2:
    """Return the distance to a surfel's plane and the alpha there; alpha is 0 where the surfel is missed."""
    normal, h = triple(record, g, _N), triple(record, g, 0) - o
    cosine = wp.dot(normal, d)
    if cosine * cosine <= _GRAZING:
        return wp.vec2(0.0, 0.0)
    t = wp.dot(normal, h) / cosine
    at = d * t - h
    u, v = wp.dot(at, triple(record, g, _U)), wp.dot(at, triple(record, g, _V))
    rho = u * u + v * v
    if not (rho <= record[g, _CUT]):
        return wp.vec2(0.0, 0.0)
    return wp.vec2(t, wp.min(wp.exp(-0.5 * rho) * record[g, _O], _ALPHA_MAX))


@wp.func
def distance_of(hit: wp.uint64) -> float:
    """Return the distance of a hit."""
    return wp.cast(wp.uint32(hit >> wp.uint64(32)), wp.float32)


@wp.func
def number_of(hit: wp.uint64) -> int:
    """Return the index of the Gaussian of a hit."""
    return int(wp.uint32(hit & wp.uint64(0xFFFFFFFF)))


@wp.func
def next_hits(tree: wp.uint64, record: wp.array2d(dtype=float), o: wp.vec3, d: wp.vec3, last: wp.uint64, before: float):
    """Find the next hits behind the hit `last`, where the transmittance is `before`; return their number, the hits and their alphas."""
    hits, alphas = Hits(wp.uint64(0)), Alphas(0.0)
    n, behind, furthest, t_max = int(0), float(before), wp.uint64(_BEHIND_ALL), float(_FAR)
    query = wp.bvh_query_ray(tree, o, safe(d))
    g = int(0)
    while wp.bvh_query_next(query, g, t_max):
        met = meet(record, g, o, d)
        if met[1] > 0.0 and met[0] > 0.0:
            hit = (wp.uint64(wp.cast(met[0], wp.uint32)) << wp.uint64(32)) | wp.uint64(g)
            if last < hit and hit <= furthest:
                place = int(n)
                if n == _NEAREST:
                    place -= 1
                    behind /= 1.0 - alphas[place]
                else:
                    n += 1
                while place > 0 and hits[wp.max(place - 1, 0)] > hit:
                    hits[place] = hits[place - 1]
                    alphas[place] = alphas[place - 1]
                    place -= 1
                hits[place] = hit
                alphas[place] = met[1]
                behind *= 1.0 - met[1]
                while n > 1 and behind <= _SOLID * (1.0 - alphas[wp.max(n - 1, 0)]):
                    n -= 1
                    behind /= 1.0 - alphas[n]
                if n == _NEAREST or behind <= _SOLID:
                    furthest = hits[n - 1]
                    t_max = distance_of(furthest) * 1.00001
    return n, hits, alphas


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
        tree: wp.uint64, record: wp.array2d(dtype=float), origin: wp.array(dtype=wp.vec3), direction: wp.array(dtype=wp.vec3),
        sh: wp.array(dtype=float), coefficients: int, extra: wp.array(dtype=float), out: wp.array2d(dtype=float),
        hits_of: wp.array(dtype=wp.int64), left: wp.array(dtype=float),
    ):  # fmt: skip
        """Write sums (R, 8 + E), number of hits (R,) and transmittance (R,) of rays; rows of Gaussians: sh (N, 3 K), extra (N, E)."""
        ray = wp.tid()
        o, d = origin[ray], direction[ray]
        b = basis(d, coefficients)
        colour, normal, acc, depth, before = wp.vec3(0.0, 0.0, 0.0), wp.vec3(0.0, 0.0, 0.0), Row(0.0), float(0.0), float(1.0)
        last, n, total = wp.uint64(_BEFORE_ALL), int(_NEAREST), int(0)
        while n == _NEAREST and before > _OPAQUE:
            n, hits, alphas = next_hits(tree, record, o, d, last, before)
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
    tree: wp.uint64, record: wp.array2d(dtype=float), origin: wp.array(dtype=wp.vec3), direction: wp.array(dtype=wp.vec3),
    start: wp.array(dtype=wp.int64), index: wp.array(dtype=int), weight: wp.array(dtype=float), distance: wp.array(dtype=float),
    of: wp.array(dtype=int),
):  # fmt: skip
    """Write the hits of each ray r to start[r]..start[r + 1], counted before; of: (H,) ray of each hit."""
    ray = wp.tid()
    if start[ray] == start[ray + 1]:
        return
    o, d = origin[ray], direction[ray]
    first = int(start[ray])
    last, n, at, before = wp.uint64(_BEFORE_ALL), int(_NEAREST), int(first), float(1.0)
    while n == _NEAREST and before > _OPAQUE:
        n, hits, alphas = next_hits(tree, record, o, d, last, before)
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
