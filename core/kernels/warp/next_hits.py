# SPDX-License-Identifier: GPL-3.0-or-later
"""Next hits of a ray with 2D Gaussians on the GPU, in exact order; definitions are in core/kernels/cpu/trace.py.

A ray visits the nearer of two boxes first. It keeps its NEAREST next hits sorted by distance, then by the index of the Gaussian, and
restarts behind the last of them where they do not make it opaque: no hit is dropped or counted twice.
"""

import warp as wp

from ..constants import ALPHA_MAX, AXIS_U, AXIS_V, CUT, GRAZING, NORMAL, OPACITY, TRANSMITTANCE_MIN
from .nodes import MISS, Distances, Stack, entered

NEAREST = 32  # hits collected in one traversal
_NEAREST = wp.constant(NEAREST)
_N, _U, _V, _O, _CUT = wp.constant(NORMAL), wp.constant(AXIS_U), wp.constant(AXIS_V), wp.constant(OPACITY), wp.constant(CUT)
_TINY = wp.constant(1.0e-12)  # smallest magnitude of a component of a direction
_FAR = wp.constant(3.0e38)
_ALPHA_MAX, _GRAZING = wp.constant(ALPHA_MAX), wp.constant(GRAZING)
_SOLID = wp.constant(0.9999 * TRANSMITTANCE_MIN)  # safely opaque despite the rounding of a product updated many times
BEFORE_ALL, _BEHIND_ALL = wp.constant(wp.uint64(2**31 - 1)), wp.constant(wp.uint64(0x7F7FFFFFFFFFFFFF))  # sort before and behind all

Hits = wp.types.vector(length=NEAREST, dtype=wp.uint64)
Alphas = wp.types.vector(length=NEAREST, dtype=wp.float32)


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
def next_hits(
    nodes: wp.array(dtype=wp.vec4), items: wp.array(dtype=int), record: wp.array2d(dtype=float), o: wp.vec3, d: wp.vec3, last: wp.uint64,
    before: float,
):  # fmt: skip
    """Find the next hits behind the hit `last`, where the transmittance is `before`; return their number, the hits and their alphas."""
    hits, alphas = Hits(wp.uint64(0)), Alphas(0.0)
    n, behind, furthest = int(0), float(before), wp.uint64(_BEHIND_ALL)
    t_min, t_max = distance_of(last) * 0.99999, float(_FAR)
    s = safe(d)
    inverse = wp.vec3(1.0 / s[0], 1.0 / s[1], 1.0 / s[2])
    waiting, reached, size = Stack(0), Distances(0.0), int(0)
    here, visiting = wp.cast(nodes[nodes.shape[0] - 1][3], wp.int32), int(1)
    while visiting == 1:
        if here >= 0:
            left, right = nodes[4 * here], nodes[4 * here + 2]
            a = entered(left, nodes[4 * here + 1], o, inverse, t_min, t_max)
            b = entered(right, nodes[4 * here + 3], o, inverse, t_min, t_max)
            nearer, further = wp.where(a <= b, left[3], right[3]), wp.where(a <= b, right[3], left[3])
            if wp.max(a, b) < MISS:
                waiting[size] = wp.cast(further, wp.int32)
                reached[size] = wp.max(a, b)
                size += 1
            if wp.min(a, b) < MISS:
                here = wp.cast(nearer, wp.int32)
                continue
        else:
            place, more = ~here, int(1)
            while more == 1:
                g = items[place]
                more = wp.where(g < 0, 1, 0)
                g = wp.where(g < 0, ~g, g)
                place += 1
                met = meet(record, g, o, d)
                if met[1] > 0.0 and met[0] > 0.0:
                    hit = (wp.uint64(wp.cast(met[0], wp.uint32)) << wp.uint64(32)) | wp.uint64(g)
                    if last < hit and hit <= furthest:
                        at = int(n)
                        if n == _NEAREST:
                            at -= 1
                            behind /= 1.0 - alphas[at]
                        else:
                            n += 1
                        while at > 0 and hits[wp.max(at - 1, 0)] > hit:
                            hits[at] = hits[at - 1]
                            alphas[at] = alphas[at - 1]
                            at -= 1
                        hits[at] = hit
                        alphas[at] = met[1]
                        behind *= 1.0 - met[1]
                        while n > 1 and behind <= _SOLID * (1.0 - alphas[wp.max(n - 1, 0)]):
                            n -= 1
                            behind /= 1.0 - alphas[n]
                        if n == _NEAREST or behind <= _SOLID:
                            furthest = hits[n - 1]
                            t_max = distance_of(furthest) * 1.00001
        visiting = int(0)
        while size > 0 and visiting == 0:
            size -= 1
            if reached[size] <= t_max:
                here, visiting = waiting[size], int(1)
    return n, hits, alphas
