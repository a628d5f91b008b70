# SPDX-License-Identifier: GPL-3.0-or-later
"""Adjoint of ray tracing: gradients of radiance, attributes and geometry; the formulas are in core/kernels/cpu/adjoint.py.

A first kernel runs over the hits of each ray and stores the gradients of their geometry per hit. A second one sums, for each Gaussian,
over its hits in the order of the rays: the sum is always the same.
"""

import warp as wp

from ..constants import ALPHA_MAX, AXIS_U, AXIS_V, CUT, NORMAL, OPACITY, SCALE_U, SCALE_V, SURFEL_GRADIENTS, TRANSMITTANCE_MIN
from .harmonics import Basis, basis, basis_pull, quaternion_gradient
from .surfels import facing, shown, triple

_N, _U, _V, _O, _CUT = wp.constant(NORMAL), wp.constant(AXIS_U), wp.constant(AXIS_V), wp.constant(OPACITY), wp.constant(CUT)
_SU, _SV, _GEOMETRY = wp.constant(SCALE_U), wp.constant(SCALE_V), wp.constant(SURFEL_GRADIENTS)
_ALPHA_MAX, _OPAQUE = wp.constant(ALPHA_MAX), wp.constant(TRANSMITTANCE_MIN)
Columns = wp.types.vector(length=SURFEL_GRADIENTS, dtype=wp.float32)


@wp.kernel
def trace_backward(
    origin: wp.array(dtype=wp.vec3), direction: wp.array(dtype=wp.vec3), start: wp.array(dtype=wp.int64), index: wp.array(dtype=int),
    weight: wp.array(dtype=float), distance: wp.array(dtype=float), left: wp.array(dtype=float), record: wp.array2d(dtype=float),
    sh: wp.array(dtype=float), coefficients: int, extra: wp.array(dtype=float), extras: int, image: wp.array2d(dtype=float),
    gradient: wp.array2d(dtype=float), of_hit: wp.array2d(dtype=float), g_origin: wp.array(dtype=wp.vec3),
    g_direction: wp.array(dtype=wp.vec3),
):  # fmt: skip
    """Compute the gradients of the records per hit, of_hit (H, SURFEL_GRADIENTS), and of the rays (R,)."""
    ray = wp.tid()
    o, d = origin[ray], direction[ray]
    b = basis(d, coefficients)
    last = 7 + extras
    sums = float(0.0)
    for j in range(last):
        sums += gradient[ray, j] * image[ray, j]
    scale, shift, s_total = float(1.0), float(gradient[ray, last]), sums + gradient[ray, last] * (1.0 - left[ray])
    if left[ray] <= _OPAQUE:
        scale = 1.0 / (1.0 - left[ray])
        shift = -sums * scale
        s_total = 0.0
    g_colour = wp.vec3(gradient[ray, 0], gradient[ray, 1], gradient[ray, 2])
    g_normal = wp.vec3(gradient[ray, 3], gradient[ray, 4], gradient[ray, 5])
    g_depth = gradient[ray, 6 + extras]
    before, run = float(1.0), float(0.0)
    towards, go, gd = Basis(0.0), wp.vec3(0.0, 0.0, 0.0), wp.vec3(0.0, 0.0, 0.0)
    for hit in range(int(start[ray]), int(start[ray + 1])):
        g, w, t = index[hit], weight[hit], distance[hit]
        q = g_depth * t
        if coefficients > 0:
            for channel in range(3):
                at = (g * 3 + channel) * coefficients
                value = shown(b, sh, at, coefficients)
                if value > 0.0:
                    q += g_colour[channel] * value
                    for j in range(16):
                        if j < coefficients:
                            towards[j] += w * g_colour[channel] * sh[at + j]
        for j in range(extras):
            q += gradient[ray, 6 + j] * extra[g * extras + j]
        normal = triple(record, g, _N)
        side = facing(normal, d)
        q = (q + wp.dot(g_normal, normal) * side) * scale + shift

        h = o - triple(record, g, 0) + d * t
        axis_u, axis_v = triple(record, g, _U), triple(record, g, _V)
        u, v = wp.dot(h, axis_u), wp.dot(h, axis_v)
        bell = wp.exp(-0.5 * (u * u + v * v))
        alpha = wp.min(bell * record[g, _O], _ALPHA_MAX)
        run += before * alpha * q
        g_alpha = before * q - (s_total - run) / (1.0 - alpha)
        before *= 1.0 - alpha
        gu, gv = float(0.0), float(0.0)
        of_hit[hit, _O] = 0.0
        if bell * record[g, _O] < _ALPHA_MAX:
            of_hit[hit, _O] = g_alpha * bell
            gu = -g_alpha * alpha * u
            gv = -g_alpha * alpha * v
        gh = axis_u * gu + axis_v * gv
        gt = (w * g_depth + wp.dot(gh, d)) / wp.dot(normal, d)
        gc = normal * gt - gh
        gn = g_normal * (w * side) - h * gt
        go -= gc
        gd -= gc * t
        for axis in range(3):
            of_hit[hit, axis] = gc[axis]
            of_hit[hit, _N + axis] = gn[axis]
            of_hit[hit, _U + axis] = gu * h[axis]
            of_hit[hit, _V + axis] = gv * h[axis]
    g_origin[ray] = go
    g_direction[ray] = gd + basis_pull(d, coefficients, towards)


@wp.kernel
def surfel_backward(
    order: wp.array(dtype=wp.int64), first: wp.array(dtype=int), of_hit: wp.array2d(dtype=float), record: wp.array2d(dtype=float),
    quaternion: wp.array(dtype=float), n: int, g_position: wp.array(dtype=float), g_quaternion: wp.array(dtype=float),
    g_log_scale: wp.array(dtype=float), g_opacity: wp.array(dtype=float),
):  # fmt: skip
    """Sum the gradients of the hits of Gaussian i, order[first[i]:first[i + 1]], and convert them to those of its raw parameters."""
    i = wp.tid()
    s = Columns(0.0)
    for k in range(first[i], first[i + 1]):
        for j in range(_GEOMETRY):
            s[j] += of_hit[order[k], j]
    for axis in range(3):
        g_position[axis * n + i] = s[axis]
    log_u, log_v, alpha = float(0.0), float(0.0), record[i, _O]
    gq = wp.vec4(0.0, 0.0, 0.0, 0.0)
    if record[i, _CUT] >= 0.0:
        for axis in range(3):
            log_u -= s[_U + axis] * record[i, _U + axis]
            log_v -= s[_V + axis] * record[i, _V + axis]
        su, sv = record[i, _SU], record[i, _SV]
        gu, gv = wp.vec3(s[_U], s[_U + 1], s[_U + 2]) / su, wp.vec3(s[_V], s[_V + 1], s[_V + 2]) / sv
        raw = wp.vec4(quaternion[i], quaternion[n + i], quaternion[2 * n + i], quaternion[3 * n + i])
        gq = quaternion_gradient(raw, gu, gv, wp.vec3(s[_N], s[_N + 1], s[_N + 2]))
    for j in range(4):
        g_quaternion[j * n + i] = gq[j]
    g_log_scale[i] = log_u
    g_log_scale[n + i] = log_v
    if record[i, _CUT] >= 0.0:
        g_opacity[i] = s[_O] * alpha * (1.0 - alpha)
    else:
        g_opacity[i] = 0.0


@wp.kernel
def rows_backward(
    order: wp.array(dtype=wp.int64), first: wp.array(dtype=int), of: wp.array(dtype=int), weight: wp.array(dtype=float),
    direction: wp.array(dtype=wp.vec3), sh: wp.array(dtype=float), coefficients: int, extras: int, gradient: wp.array2d(dtype=float),
    n: int, g_sh: wp.array(dtype=float), g_extra: wp.array(dtype=float),
):  # fmt: skip
    """Sum the gradients of Gaussian i over its hits: of SH channel c < 3 (K, 3, N), or of extra channel c - 3 (E, N)."""
    i, c = wp.tid()
    if c >= 3:
        total = float(0.0)
        for k in range(first[i], first[i + 1]):
            hit = order[k]
            total += weight[hit] * gradient[of[hit], 3 + c]
        g_extra[(c - 3) * n + i] = total
        return
    acc = Basis(0.0)
    for k in range(first[i], first[i + 1]):
        hit = order[k]
        b = basis(direction[of[hit]], coefficients)
        if shown(b, sh, (i * 3 + c) * coefficients, coefficients) > 0.0:
            acc += b * (weight[hit] * gradient[of[hit], c])
    for j in range(16):
        if j < coefficients:
            g_sh[(j * 3 + c) * n + i] = acc[j]


@wp.kernel
def pad_hits(
    ray: wp.array(dtype=wp.int64), start: wp.array(dtype=wp.int64), index: wp.array(dtype=int), longest: int, filler: int,
    padded: wp.array2d(dtype=int),
):  # fmt: skip
    """Write the Gaussians of the hits of chosen rays to padded (B, longest), `filler` behind the last hit: a size that the host knows."""
    b, k = wp.tid()
    hit = start[ray[b]] + wp.int64(k)
    if hit < start[ray[b] + wp.int64(1)]:
        padded[b, k] = index[hit]
    else:
        padded[b, k] = filler


@wp.kernel
def blend_backward(
    order: wp.array(dtype=wp.int64), first: wp.array(dtype=int), ray: wp.array(dtype=wp.int64), start: wp.array(dtype=wp.int64),
    longest: int, weight: wp.array(dtype=float), gradient: wp.array2d(dtype=float), out: wp.array2d(dtype=float),
):  # fmt: skip
    """Sum the gradients (C, N) of blended values over each Gaussian's places in `pad_hits`."""
    channel, i = wp.tid()
    total = float(0.0)
    for k in range(first[i], first[i + 1]):
        b = int(order[k]) / longest
        hit = start[ray[b]] + order[k] % wp.int64(longest)
        total += weight[hit] * gradient[b, channel]
    out[channel, i] = total
