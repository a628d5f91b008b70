# SPDX-License-Identifier: GPL-3.0-or-later
"""CPU kernels of the specular lobe over the texels of a light, 8 directions to a vector.

core/kernels/lobes.py defines the arrays, the order of the directions and how the lobe is split into f_s = F0 D V (1 - p) + D V p.
"""

from __future__ import annotations

import math

import numpy as np

from ..constants import SHORTEST2
from .jit import helper, kernel
from .reductions import total
from .simd import bits, load, maximum, splat, sqrt, store

_HALF_PI = np.float32(0.5 / math.pi)
_ZERO, _ONE, _HALF = np.float32(0.0), np.float32(1.0), np.float32(0.5)
_SHORTEST2 = np.float32(SHORTEST2)


@helper
def _lobe(vx, vy, vz, nx, ny, nz, n_v, dx, dy, dz, n_l, a2):
    """Return D V n.l and (1 - v.h)^5 in 8 directions with n_l >= 0.

    D is computed from the sine of the half vector: near 1 its cosine has no significant digits left.
    """
    hx, hy, hz = dx + vx, dy + vy, dz + vz
    length2 = maximum(hx * hx + hy * hy + hz * hz, splat(_SHORTEST2))
    n_h = n_l + n_v
    tx, ty, tz = hx - n_h * nx, hy - n_h * ny, hz - n_h * nz
    k = (tx * tx + ty * ty + tz * tz) / length2 * (_ONE - a2) + a2
    both = n_l * np.float32(math.sqrt(n_v * n_v * (_ONE - a2) + a2)) + sqrt(n_l * n_l * (_ONE - a2) + a2) * n_v
    x = maximum(splat(_ONE) - sqrt(length2) * _HALF, splat(_ZERO))
    x2 = x * x
    return n_l * (a2 * _HALF_PI) / (k * k * both), x2 * x2 * x


@helper
def _cosines(direction, count, at, nx, ny, nz):
    """Return 8 directions and their cosines to a normal."""
    dx, dy, dz = load(direction, at), load(direction, count + at), load(direction, 2 * count + at)
    return dx, dy, dz, dx * nx + dy * ny + dz * nz


@kernel
def lobe_rows_range(
    begin, end, texels, subs, point, view, normal, alpha, direction, solid_angle, visible, indirect, scaled, added, rest_scaled, rest_added
):  # fmt: skip
    """Compute for views begin..end both parts of the lobe per texel, (K, texels) flat, and applied to the indirect light, (K, 3)."""
    count, zero = texels * subs, splat(_ZERO)
    for k in range(begin, end):
        p = point[k]
        nx, ny, nz = normal[p, 0], normal[p, 1], normal[p, 2]
        vx, vy, vz = view[k, 0], view[k, 1], view[k, 2]
        n_v = max(nx * vx + ny * vy + nz * vz, np.float32(1e-3))
        a2 = alpha[p] * alpha[p]
        r0, r1, r2, s0, s1, s2 = zero, zero, zero, zero, zero, zero
        for texel in range(0, texels, 8):
            sum_scaled, sum_added = zero, zero
            for sub in range(subs):
                at = sub * texels + texel
                dx, dy, dz, n_l = _cosines(direction, count, at, nx, ny, nz)
                if bits(n_l > _ZERO) == 0:
                    continue
                value, power = _lobe(vx, vy, vz, nx, ny, nz, n_v, dx, dy, dz, maximum(n_l, zero), a2)
                value = value * load(solid_angle, at)
                bias = value * power
                value = value - bias
                free = load(visible, p * count + at)
                sum_scaled, sum_added = sum_scaled + value * free, sum_added + bias * free
                i0 = load(indirect, p * 3 * count + at)
                i1 = load(indirect, (p * 3 + 1) * count + at)
                i2 = load(indirect, (p * 3 + 2) * count + at)
                r0, r1, r2 = r0 + value * i0, r1 + value * i1, r2 + value * i2
                s0, s1, s2 = s0 + bias * i0, s1 + bias * i1, s2 + bias * i2
            store(scaled, k * texels + texel, sum_scaled)
            store(added, k * texels + texel, sum_added)
        rest_scaled[k, 0], rest_scaled[k, 1], rest_scaled[k, 2] = total(r0), total(r1), total(r2)
        rest_added[k, 0], rest_added[k, 1], rest_added[k, 2] = total(s0), total(s1), total(s2)


@kernel
def lobe_sums_range(
    begin, end, texels, subs, point, view, normal, alphas, direction, solid_angle, visible, indirect, light, scaled, added
):  # fmt: skip
    """Integrate for views begin..end both parts of the lobe over all light, (K, J, 3).

    alphas: (J,) GGX widths; light: (3 texels,) channel by channel.
    """
    count, zero, widths = texels * subs, splat(_ZERO), len(alphas)
    sums = np.empty(widths * 48, np.float32)
    for k in range(begin, end):
        p = point[k]
        nx, ny, nz = normal[p, 0], normal[p, 1], normal[p, 2]
        vx, vy, vz = view[k, 0], view[k, 1], view[k, 2]
        n_v = max(nx * vx + ny * vy + nz * vz, np.float32(1e-3))
        sums[:] = _ZERO
        for sub in range(subs):
            for texel in range(0, texels, 8):
                at = sub * texels + texel
                dx, dy, dz, n_l = _cosines(direction, count, at, nx, ny, nz)
                if bits(n_l > _ZERO) == 0:
                    continue
                n_l = maximum(n_l, zero)
                angle = load(solid_angle, at)
                free = load(visible, p * count + at)
                l0 = (load(light, texel) * free + load(indirect, p * 3 * count + at)) * angle
                l1 = (load(light, texels + texel) * free + load(indirect, (p * 3 + 1) * count + at)) * angle
                l2 = (load(light, 2 * texels + texel) * free + load(indirect, (p * 3 + 2) * count + at)) * angle
                for j in range(widths):
                    value, power = _lobe(vx, vy, vz, nx, ny, nz, n_v, dx, dy, dz, n_l, alphas[j] * alphas[j])
                    bias = value * power
                    value = value - bias
                    to = j * 48
                    store(sums, to, load(sums, to) + value * l0)
                    store(sums, to + 8, load(sums, to + 8) + value * l1)
                    store(sums, to + 16, load(sums, to + 16) + value * l2)
                    store(sums, to + 24, load(sums, to + 24) + bias * l0)
                    store(sums, to + 32, load(sums, to + 32) + bias * l1)
                    store(sums, to + 40, load(sums, to + 40) + bias * l2)
        for j in range(widths):
            for channel in range(3):
                scaled[k, j, channel] = total(load(sums, j * 48 + channel * 8))
                added[k, j, channel] = total(load(sums, j * 48 + 24 + channel * 8))
