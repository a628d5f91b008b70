# SPDX-License-Identifier: GPL-3.0-or-later
"""Adjoint of ray tracing: gradients of surfels, ray origins and ray directions.

Along the hits of a ray it is the adjoint of compositing that core/kernels/cpu/raster.py derives. With h = o + t d - c, the hit relative
to the centre,

    u = h . t_u / s_u,   v = h . t_v / s_v,   t = n . (c - o) / n . d,

so that a gradient g_h of h and g_t of t give, with g_c = (g_t + g_h . d) n / (n . d) - g_h,

    g_c for the centre,   -g_c for the origin,   -t g_c for the direction,   -(g_t + g_h . d) h / (n . d) for the normal.
"""

from __future__ import annotations

import math

import numpy as np

from ..constants import ALPHA_MAX, AXIS_U, AXIS_V, CUT, NORMAL, OPACITY, SCALE_U, SCALE_V, SURFEL_GRADIENTS, TRANSMITTANCE_MIN
from .compositing import SH_ROW, add_radiance, facing, radiance, spread_basis
from .frame import quaternion_gradient
from .harmonics import basis_gradient
from .jit import helper, kernel
from .simd import load, splat, store

_ZERO, _HALF, _ONE = np.float32(0.0), np.float32(0.5), np.float32(1.0)


@helper
def _upstream(image, gradient, ray, left):
    """Return the terms that all hits of a ray share: the scale of the sums, the term g . C added to every q, and S_total."""
    last = gradient.shape[1] - 1
    sums = _ZERO
    for j in range(last):
        sums += gradient[ray, j] * image[ray, j]
    if left <= np.float32(TRANSMITTANCE_MIN):
        scale = _ONE / (_ONE - left)
        return scale, -sums * scale, _ZERO
    return _ONE, gradient[ray, last], sums + gradient[ray, last] * (_ONE - left)


@kernel
def trace_backward_range(
    slot, begin, end, origin, direction, start, index, weight, distance, left, record, rows, coefficients, extras, image, gradient,
    slots, g_origin, g_direction,
):  # fmt: skip
    """Compute the adjoint of tracing rays begin..end.

    Adds to slots[slot] (N, width + SURFEL_GRADIENTS) and writes g_origin and g_direction (R, 3).
    """
    width, stride = rows.shape[1], slots.shape[2]
    offset = SH_ROW if coefficients > 0 else 0
    row, out = rows.reshape(-1), slots[slot].reshape(-1)
    axes, values, spread = np.zeros(24, np.float32), np.zeros(128, np.float32), np.zeros(128, np.float32)
    slopes, towards = np.zeros(3 * 128, np.float32), np.zeros(16, np.float32)
    for ray in range(begin, end):
        lane = (ray - begin) % 8
        if coefficients > 0 and lane == 0:
            spread_basis(direction, ray, end, coefficients, axes, values, spread)
            basis_gradient(load(axes, 0), load(axes, 8), load(axes, 16), coefficients, slopes)
        low, high = load(spread, lane * 16), load(spread, lane * 16 + 8)
        to_low, to_high = splat(_ZERO), splat(_ZERO)
        dx, dy, dz = direction[3 * ray], direction[3 * ray + 1], direction[3 * ray + 2]
        scale, shift, s_total = _upstream(image, gradient, ray, left[ray])
        before, run = _ONE, _ZERO
        gox, goy, goz, gdx, gdy, gdz = _ZERO, _ZERO, _ZERO, _ZERO, _ZERO, _ZERO
        for hit in range(start[ray], start[ray + 1]):
            g, w, t = index[hit], weight[hit], distance[hit]
            at, here = g * width, g * stride
            q = gradient[ray, 6 + extras] * t
            if coefficients > 0:
                lit = 0
                for channel in range(3):
                    value = radiance(row, at, channel, low, high)
                    if value > 0:
                        lit |= 1 << channel
                        q += gradient[ray, channel] * value
                        weighted = w * gradient[ray, channel]
                        to_low = to_low + load(row, at + channel * 16) * weighted
                        to_high = to_high + load(row, at + channel * 16 + 8) * weighted
                add_radiance(out, here, low, high, w, gradient, ray, lit)
            for j in range(extras):
                q += gradient[ray, 6 + j] * row[at + offset + j]
                out[here + offset + j] += w * gradient[ray, 6 + j]
            here += width
            side = facing(record, g, dx, dy, dz)
            for axis in range(3):
                q += gradient[ray, 3 + axis] * side * record[g, NORMAL + axis]
            q = q * scale + shift

            hx = origin[3 * ray] - record[g, 0] + dx * t
            hy = origin[3 * ray + 1] - record[g, 1] + dy * t
            hz = origin[3 * ray + 2] - record[g, 2] + dz * t
            u = hx * record[g, AXIS_U] + hy * record[g, AXIS_U + 1] + hz * record[g, AXIS_U + 2]
            v = hx * record[g, AXIS_V] + hy * record[g, AXIS_V + 1] + hz * record[g, AXIS_V + 2]
            bell = np.float32(math.exp(-_HALF * (u * u + v * v)))
            alpha = min(bell * record[g, OPACITY], np.float32(ALPHA_MAX))
            run += before * alpha * q
            g_alpha = before * q - (s_total - run) / (_ONE - alpha)
            before *= _ONE - alpha
            gu, gv = _ZERO, _ZERO
            if bell * record[g, OPACITY] < np.float32(ALPHA_MAX):
                out[here + OPACITY] += g_alpha * bell
                gu, gv = -g_alpha * alpha * u, -g_alpha * alpha * v

            ghx = gu * record[g, AXIS_U] + gv * record[g, AXIS_V]
            ghy = gu * record[g, AXIS_U + 1] + gv * record[g, AXIS_V + 1]
            ghz = gu * record[g, AXIS_U + 2] + gv * record[g, AXIS_V + 2]
            nx, ny, nz = record[g, NORMAL], record[g, NORMAL + 1], record[g, NORMAL + 2]
            gt = (w * gradient[ray, 6 + extras] + ghx * dx + ghy * dy + ghz * dz) / (nx * dx + ny * dy + nz * dz)
            gcx, gcy, gcz = gt * nx - ghx, gt * ny - ghy, gt * nz - ghz
            gox, goy, goz = gox - gcx, goy - gcy, goz - gcz
            gdx, gdy, gdz = gdx - t * gcx, gdy - t * gcy, gdz - t * gcz
            turned = w * side
            sums = (
                gcx, gcy, gcz,
                turned * gradient[ray, 3] - gt * hx, turned * gradient[ray, 4] - gt * hy, turned * gradient[ray, 5] - gt * hz,
                gu * hx, gu * hy, gu * hz, gv * hx, gv * hy, gv * hz,
            )  # fmt: skip
            for j in range(OPACITY):
                out[here + j] += sums[j]
        store(towards, 0, to_low)
        store(towards, 8, to_high)
        for j in range(coefficients):
            gdx += slopes[j * 8 + lane] * towards[j]
            gdy += slopes[128 + j * 8 + lane] * towards[j]
            gdz += slopes[256 + j * 8 + lane] * towards[j]
        g_origin[ray, 0], g_origin[ray, 1], g_origin[ray, 2] = gox, goy, goz
        g_direction[ray, 0], g_direction[ray, 1], g_direction[ray, 2] = gdx, gdy, gdz


@kernel
def surfel_backward_range(begin, end, slots, width, record, quaternion, n, g_position, g_quaternion, g_log_scale, g_opacity):
    """Sum the slots' gradients of records (threads, N, width + SURFEL_GRADIENTS) and convert them to those of the raw parameters.

    The results are flat: g_position (3 N), g_quaternion (4 N), g_log_scale (2 N), g_opacity (N); 0 for surfels that no ray can hit.
    """
    s = np.empty(SURFEL_GRADIENTS, np.float32)
    for i in range(begin, end):
        s[:] = _ZERO
        if record[i, CUT] >= 0:
            for slot in range(len(slots)):
                for j in range(SURFEL_GRADIENTS):
                    s[j] += slots[slot, i, width + j]
        q = (_ONE, _ZERO, _ZERO, _ZERO)
        inv, su, sv, log_u, log_v, o = _ONE, _ONE, _ONE, _ZERO, _ZERO, _ZERO
        if record[i, CUT] >= 0:
            w, x, y, z = quaternion[i], quaternion[n + i], quaternion[2 * n + i], quaternion[3 * n + i]
            inv = _ONE / np.float32(math.sqrt(max(w * w + x * x + y * y + z * z, np.float32(1e-20))))
            q = (w * inv, x * inv, y * inv, z * inv)
            su, sv, o = record[i, SCALE_U], record[i, SCALE_V], record[i, OPACITY]
            for axis in range(3):
                log_u -= s[AXIS_U + axis] * record[i, AXIS_U + axis]
                log_v -= s[AXIS_V + axis] * record[i, AXIS_V + axis]
        g_u = (s[AXIS_U] / su, s[AXIS_U + 1] / su, s[AXIS_U + 2] / su)
        g_v = (s[AXIS_V] / sv, s[AXIS_V + 1] / sv, s[AXIS_V + 2] / sv)
        turn = quaternion_gradient(q, inv, g_u, g_v, (s[NORMAL], s[NORMAL + 1], s[NORMAL + 2]))
        for j in range(4):
            g_quaternion[j * n + i] = turn[j]
        for axis in range(3):
            g_position[axis * n + i] = s[axis]
        g_log_scale[i], g_log_scale[n + i] = log_u, log_v
        g_opacity[i] = s[OPACITY] * o * (_ONE - o)
