# SPDX-License-Identifier: GPL-3.0-or-later
"""CPU kernels of the specular lobe over the texels of a light, 8 directions to a vector.

core/kernels/lobes.py defines the arrays, the order of the directions and how the lobe is split into f_s = F0 D V (1 - w) + D V w.
"""

from __future__ import annotations

import math

import numpy as np

from ..constants import NARROW, SHORTEST2
from ..constants import PER_STRATUM as _PER_STRATUM
from .fresnel import fresnel_weight
from .jit import helper, kernel
from .reductions import total
from .simd import bits, load, maximum, select, splat, sqrt, store

_HALF_PI = np.float32(0.5 / math.pi)
_ZERO, _ONE, _HALF = np.float32(0.0), np.float32(1.0), np.float32(0.5)
_SHORTEST2, _NARROW = np.float32(SHORTEST2), np.float32(NARROW)
_SHARE = np.float32(1 / _PER_STRATUM)


@helper
def _lobe(vx, vy, vz, nx, ny, nz, n_v, dx, dy, dz, n_l, a2):
    """Return D V n.l, the Fresnel weight w and sin^2 (n, h) + alpha^2, about, in 8 directions with n_l >= 0.

    D is computed from the sine of the half vector: near 1 its cosine has no significant digits left.
    """
    hx, hy, hz = dx + vx, dy + vy, dz + vz
    length2 = maximum(hx * hx + hy * hy + hz * hz, splat(_SHORTEST2))
    n_h = n_l + n_v
    tx, ty, tz = hx - n_h * nx, hy - n_h * ny, hz - n_h * nz
    k = (tx * tx + ty * ty + tz * tz) / length2 * (_ONE - a2) + a2
    both = n_l * np.float32(math.sqrt(n_v * n_v * (_ONE - a2) + a2)) + sqrt(n_l * n_l * (_ONE - a2) + a2) * n_v
    x = maximum(splat(_ONE) - sqrt(length2) * _HALF, splat(_ZERO))
    return n_l * (a2 * _HALF_PI) / (k * k * both), fresnel_weight(x), k


@helper
def _cosines(direction, count, at, nx, ny, nz):
    """Return 8 directions and their cosines to a normal."""
    dx, dy, dz = load(direction, at), load(direction, count + at), load(direction, 2 * count + at)
    return dx, dy, dz, dx * nx + dy * ny + dz * nz


@helper
def _mean_lobe(strata, at, vx, vy, vz, nx, ny, nz, n_v, a2):
    """Return the means over the directions within direction `at` of D V n.l (1 - w) and D V n.l w."""
    value, bias = splat(_ZERO), splat(_ZERO)
    for i in range(3 * _PER_STRATUM * at, 3 * _PER_STRATUM * at + _PER_STRATUM, 8):
        dx, dy, dz = load(strata, i), load(strata, i + _PER_STRATUM), load(strata, i + 2 * _PER_STRATUM)
        n_l = maximum(dx * nx + dy * ny + dz * nz, splat(_ZERO))
        one, weight, _ = _lobe(vx, vy, vz, nx, ny, nz, n_v, dx, dy, dz, n_l, a2)
        value, bias = value + one, bias + one * weight
    return total(value - bias) * _SHARE, total(bias) * _SHARE


@helper
def _listed(narrow, count, at, lanes, factor, offset):
    """Append `factor` (at + lane) + `offset` to the list `narrow` of `count` entries for each bit of `lanes`; return the new count."""
    for lane in range(8):
        if lanes >> lane & 1:
            narrow[count] = factor * (at + lane) + offset
            count += 1
    return count


@kernel
def lobe_rows_range(
    begin, end, texels, subs, point, view, normal, alpha, direction, solid_angle, visible, indirect, strata, f0_term, fresnel_term,
    f0_indirect, fresnel_indirect,
):  # fmt: skip
    """Compute for views begin..end both parts of the lobe per texel, (K, texels) flat, and applied to the indirect light, (K, 3)."""
    count, zero = texels * subs, splat(_ZERO)
    narrow = np.empty(count, np.int64)  # directions whose lobe is a mean
    for k in range(begin, end):
        p, listed = point[k], 0
        nx, ny, nz = normal[p, 0], normal[p, 1], normal[p, 2]
        vx, vy, vz = view[k, 0], view[k, 1], view[k, 2]
        n_v = max(nx * vx + ny * vy + nz * vz, np.float32(1e-3))
        a2 = alpha[p] * alpha[p]
        r0, r1, r2, s0, s1, s2 = zero, zero, zero, zero, zero, zero
        for texel in range(0, texels, 8):
            sum_f0, sum_fresnel = zero, zero
            for sub in range(subs):
                at = sub * texels + texel
                dx, dy, dz, n_l = _cosines(direction, count, at, nx, ny, nz)
                if bits(n_l > _ZERO) == 0:
                    continue
                value, weight, spread = _lobe(vx, vy, vz, nx, ny, nz, n_v, dx, dy, dz, maximum(n_l, zero), a2)
                angle = load(solid_angle, at)
                peak = (spread < angle * _NARROW) & (n_l > _ZERO)
                listed = _listed(narrow, listed, at, bits(peak), 1, 0)
                value = select(peak, zero, value * angle)
                bias = value * weight
                value = value - bias
                free = load(visible, p * count + at)
                sum_f0, sum_fresnel = sum_f0 + value * free, sum_fresnel + bias * free
                i0 = load(indirect, p * 3 * count + at)
                i1 = load(indirect, (p * 3 + 1) * count + at)
                i2 = load(indirect, (p * 3 + 2) * count + at)
                r0, r1, r2 = r0 + value * i0, r1 + value * i1, r2 + value * i2
                s0, s1, s2 = s0 + bias * i0, s1 + bias * i1, s2 + bias * i2
            store(f0_term, k * texels + texel, sum_f0)
            store(fresnel_term, k * texels + texel, sum_fresnel)
        f0_indirect[k, 0], f0_indirect[k, 1], f0_indirect[k, 2] = total(r0), total(r1), total(r2)
        fresnel_indirect[k, 0], fresnel_indirect[k, 1], fresnel_indirect[k, 2] = total(s0), total(s1), total(s2)
        for i in range(listed):
            at = narrow[i]
            mean, mean_bias = _mean_lobe(strata, at, vx, vy, vz, nx, ny, nz, n_v, a2)
            mean, mean_bias = mean * solid_angle[at], mean_bias * solid_angle[at]
            f0_term[k * texels + at % texels] += mean * visible[p * count + at]
            fresnel_term[k * texels + at % texels] += mean_bias * visible[p * count + at]
            for channel in range(3):
                reflected = indirect[(p * 3 + channel) * count + at]
                f0_indirect[k, channel] += mean * reflected
                fresnel_indirect[k, channel] += mean_bias * reflected


@kernel
def lobe_sums_range(
    begin, end, texels, subs, point, view, normal, alphas, direction, solid_angle, visible, indirect, strata, light, f0_term, fresnel_term
):  # fmt: skip
    """Integrate for views begin..end both parts of the lobe over all light, (K, J, 3).

    alphas: (J,) GGX widths; light: (3 texels,) channel by channel.
    """
    count, zero, widths = texels * subs, splat(_ZERO), len(alphas)
    sums = np.empty(widths * 48, np.float32)
    narrow = np.empty(widths * count, np.int64)  # direction times J, plus the number of the width, whose lobe is a mean
    for k in range(begin, end):
        p, listed = point[k], 0
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
                above = n_l > _ZERO
                n_l = maximum(n_l, zero)
                angle = load(solid_angle, at)
                free = load(visible, p * count + at)
                l0 = (load(light, texel) * free + load(indirect, p * 3 * count + at)) * angle
                l1 = (load(light, texels + texel) * free + load(indirect, (p * 3 + 1) * count + at)) * angle
                l2 = (load(light, 2 * texels + texel) * free + load(indirect, (p * 3 + 2) * count + at)) * angle
                for j in range(widths):
                    value, weight, spread = _lobe(vx, vy, vz, nx, ny, nz, n_v, dx, dy, dz, n_l, alphas[j] * alphas[j])
                    peak = (spread < angle * _NARROW) & above
                    listed = _listed(narrow, listed, at, bits(peak), widths, j)
                    value = select(peak, zero, value)
                    bias = value * weight
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
                f0_term[k, j, channel] = total(load(sums, j * 48 + channel * 8))
                fresnel_term[k, j, channel] = total(load(sums, j * 48 + 24 + channel * 8))
        for i in range(listed):
            at, j = narrow[i] // widths, narrow[i] % widths
            mean, mean_bias = _mean_lobe(strata, at, vx, vy, vz, nx, ny, nz, n_v, alphas[j] * alphas[j])
            for channel in range(3):
                incoming = light[channel * texels + at % texels] * visible[p * count + at]
                incoming = (incoming + indirect[(p * 3 + channel) * count + at]) * solid_angle[at]
                f0_term[k, j, channel] += mean * incoming
                fresnel_term[k, j, channel] += mean_bias * incoming
