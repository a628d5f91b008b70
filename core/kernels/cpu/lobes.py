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
_VECTOR = 56  # numbers stored of 8 directions, see `_store_directions`


@helper
def half_vector(vx, vy, vz, nx, ny, nz, n_v, dx, dy, dz, n_l):
    """Return sin^2 of the angle between the normal and the half vector, and the Fresnel weight w, in 8 directions.

    D is computed from this sine: near 1 the cosine has no significant digits left.

    Args:
        vx: x of the direction to the camera; vy and vz follow.
        vy: see vx.
        vz: see vx.
        nx: x of the normal; ny and nz follow.
        ny: see nx.
        nz: see nx.
        n_v: cosine of the two.
        dx: vector of x of the directions to the light; dy and dz follow.
        dy: see dx.
        dz: see dx.
        n_l: their cosines with the normal, >= 0.
    """
    hx, hy, hz = dx + vx, dy + vy, dz + vz
    length2 = maximum(hx * hx + hy * hy + hz * hz, splat(_SHORTEST2))
    n_h = n_l + n_v
    tx, ty, tz = hx - n_h * nx, hy - n_h * ny, hz - n_h * nz
    x = maximum(splat(_ONE) - sqrt(length2) * _HALF, splat(_ZERO))
    return (tx * tx + ty * ty + tz * tz) / length2, fresnel_weight(x)


@helper
def masking_root(n_v, a2):
    """Return sqrt((n.v)^2 (1 - alpha^2) + alpha^2), a part of V."""
    return np.float32(math.sqrt(n_v * n_v * (_ONE - a2) + a2))


@helper
def distribution(sine2, n_l, n_v, n_v_root, a2):
    """Return D V n.l, and sin^2 (n, h) + alpha^2, about, in 8 directions.

    Args:
        sine2: vector of sin^2 of normal and half vector.
        n_l: vector of cosines of normal and light, >= 0.
        n_v: cosine of normal and camera.
        n_v_root: of n_v, from `masking_root`.
        a2: alpha^2.
    """
    k = sine2 * (_ONE - a2) + a2
    both = n_l * n_v_root + sqrt(n_l * n_l * (_ONE - a2) + a2) * n_v
    return n_l * (a2 * _HALF_PI) / (k * k * both), k


@helper
def _lobe(vx, vy, vz, nx, ny, nz, n_v, dx, dy, dz, n_l, a2):
    """Return D V n.l, the Fresnel weight w and sin^2 (n, h) + alpha^2, about, in 8 directions with n_l >= 0."""
    sine2, weight = half_vector(vx, vy, vz, nx, ny, nz, n_v, dx, dy, dz, n_l)
    value, k = distribution(sine2, n_l, n_v, masking_root(n_v, a2), a2)
    return value, weight, k


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
def _listed(narrow, count, at, lanes):
    """Append at + lane to the list `narrow` of `count` entries for each bit of `lanes`; return the new count."""
    for lane in range(8):
        if lanes >> lane & 1:
            narrow[count] = at + lane
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
                listed = _listed(narrow, listed, at, bits(peak))
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


@helper
def _store_half_vector(known, to, vx, vy, vz, nx, ny, nz, n_v, dx, dy, dz, n_l):
    """Store sin^2 (n, h), n.l and w of 8 directions from known[to] on."""
    sine2, weight = half_vector(vx, vy, vz, nx, ny, nz, n_v, dx, dy, dz, n_l)
    store(known, to, sine2)
    store(known, to + 8, n_l)
    store(known, to + 16, weight)


@helper
def _stored_lobe(known, to, n_v, n_v_root, a2):
    """Return D V n.l (1 - w), D V n.l w and sin^2 (n, h) + alpha^2, about, in the 8 directions stored from known[to] on."""
    value, k = distribution(load(known, to), load(known, to + 8), n_v, n_v_root, a2)
    bias = value * load(known, to + 16)
    return value - bias, bias, k


@helper
def _store_directions(known, place, p, texels, subs, vx, vy, vz, nx, ny, nz, n_v, direction, solid_angle, visible, indirect, light):
    """Store the vectors of directions above the horizon of point p, VECTOR numbers each; return how many.

    A vector has the half vector's values, the limit of `spread` below which the lobe is a mean, and the light that arrives, 3 channels.
    """
    above, count, zero = 0, texels * subs, splat(_ZERO)
    for sub in range(subs):
        for texel in range(0, texels, 8):
            at = sub * texels + texel
            dx, dy, dz, n_l = _cosines(direction, count, at, nx, ny, nz)
            if bits(n_l > _ZERO) == 0:
                continue
            to, place[above] = _VECTOR * above, at
            above += 1
            _store_half_vector(known, to, vx, vy, vz, nx, ny, nz, n_v, dx, dy, dz, maximum(n_l, zero))
            angle, free = load(solid_angle, at), load(visible, p * count + at)
            store(known, to + 24, select(n_l > _ZERO, angle * _NARROW, zero))
            for channel in range(3):
                arriving = load(light, channel * texels + texel) * free + load(indirect, (p * 3 + channel) * count + at)
                store(known, to + 32 + 8 * channel, arriving * angle)
    return above


@helper
def _listed_peaks(lanes, first, j, peaks, narrow, listed):
    """Set bit j of `peaks` for each bit of `lanes`, direction `first` + lane; list those that were 0, and return the new length."""
    for lane in range(8):
        if lanes >> lane & 1:
            if peaks[first + lane] == 0:
                narrow[listed] = first + lane
                listed += 1
            peaks[first + lane] |= 1 << j
    return listed


@helper
def _sum_directions(known, above, j, n_v, a2, peaks, narrow, listed, f0_term, fresnel_term):
    """Set row j of the sums (J, 3) to those over the stored directions; list those whose lobe is a mean, and return the list's length."""
    zero, n_v_root = splat(_ZERO), masking_root(n_v, a2)
    r0, r1, r2, s0, s1, s2 = zero, zero, zero, zero, zero, zero
    for i in range(above):
        to = _VECTOR * i
        value, bias, spread = _stored_lobe(known, to, n_v, n_v_root, a2)
        peak = spread < load(known, to + 24)
        lanes = bits(peak)
        if lanes:
            listed = _listed_peaks(lanes, 8 * i, j, peaks, narrow, listed)
            value, bias = select(peak, zero, value), select(peak, zero, bias)
        l0, l1, l2 = load(known, to + 32), load(known, to + 40), load(known, to + 48)
        r0, r1, r2 = r0 + value * l0, r1 + value * l1, r2 + value * l2
        s0, s1, s2 = s0 + bias * l0, s1 + bias * l1, s2 + bias * l2
    f0_term[j, 0], f0_term[j, 1], f0_term[j, 2] = total(r0), total(r1), total(r2)
    fresnel_term[j, 0], fresnel_term[j, 1], fresnel_term[j, 2] = total(s0), total(s1), total(s2)
    return listed


@helper
def _store_strata(within, place, narrow, listed, vx, vy, vz, nx, ny, nz, n_v, strata):
    """Store the half vector's values of the directions within each listed one."""
    for i in range(listed):
        at = 3 * _PER_STRATUM * (place[narrow[i] // 8] + narrow[i] % 8)
        for part in range(0, _PER_STRATUM, 8):
            dx, dy, dz = load(strata, at + part), load(strata, at + _PER_STRATUM + part), load(strata, at + 2 * _PER_STRATUM + part)
            n_l = maximum(dx * nx + dy * ny + dz * nz, splat(_ZERO))
            _store_half_vector(within, 3 * (i * _PER_STRATUM + part), vx, vy, vz, nx, ny, nz, n_v, dx, dy, dz, n_l)


@helper
def _add_means(known, within, narrow, listed, peaks, j, n_v, a2, f0_term, fresnel_term):
    """Add to row j of the sums (J, 3) the lobe's mean within each listed direction with bit j, times its light."""
    zero, n_v_root = splat(_ZERO), masking_root(n_v, a2)
    r0, r1, r2, s0, s1, s2 = zero, zero, zero, zero, zero, zero
    for i in range(listed):
        at = narrow[i]
        if peaks[at] >> j & 1 == 0:
            continue
        value, bias = zero, zero
        for part in range(0, _PER_STRATUM, 8):
            one, one_bias, _ = _stored_lobe(within, 3 * (i * _PER_STRATUM + part), n_v, n_v_root, a2)
            value, bias = value + one, bias + one_bias
        to = _VECTOR * (at // 8) + 32 + at % 8
        l0, l1, l2 = known[to] * _SHARE, known[to + 8] * _SHARE, known[to + 16] * _SHARE
        r0, r1, r2 = r0 + value * l0, r1 + value * l1, r2 + value * l2
        s0, s1, s2 = s0 + bias * l0, s1 + bias * l1, s2 + bias * l2
    f0_term[j, 0] += total(r0)
    f0_term[j, 1] += total(r1)
    f0_term[j, 2] += total(r2)
    fresnel_term[j, 0] += total(s0)
    fresnel_term[j, 1] += total(s1)
    fresnel_term[j, 2] += total(s2)


@kernel
def lobe_sums_range(
    begin, end, texels, subs, point, view, normal, alphas, direction, solid_angle, visible, indirect, strata, light, f0_term, fresnel_term
):  # fmt: skip
    """Integrate for views begin..end both parts of the lobe over all light, (K, J, 3).

    alphas: (J,) GGX widths, 63 at most; light: (3 texels,) channel by channel. What no width changes is computed once and stored.
    """
    count = texels * subs
    known, place = np.empty(count // 8 * _VECTOR, np.float32), np.empty(count // 8, np.int64)
    peaks, narrow = np.zeros(count, np.int64), np.empty(count, np.int64)  # bits of the widths whose lobe is a mean; where there are any
    within = np.empty(3 * _PER_STRATUM * count, np.float32)
    for k in range(begin, end):
        p, listed = point[k], 0
        nx, ny, nz = normal[p, 0], normal[p, 1], normal[p, 2]
        vx, vy, vz = view[k, 0], view[k, 1], view[k, 2]
        n_v = max(nx * vx + ny * vy + nz * vz, np.float32(1e-3))
        arrays = (direction, solid_angle, visible, indirect, light)
        above = _store_directions(known, place, p, texels, subs, vx, vy, vz, nx, ny, nz, n_v, *arrays)
        for j in range(len(alphas)):
            a2 = alphas[j] * alphas[j]
            listed = _sum_directions(known, above, j, n_v, a2, peaks, narrow, listed, f0_term[k], fresnel_term[k])
        if listed:
            _store_strata(within, place, narrow, listed, vx, vy, vz, nx, ny, nz, n_v, strata)
            for j in range(len(alphas)):
                a2 = alphas[j] * alphas[j]
                _add_means(known, within, narrow, listed, peaks, j, n_v, a2, f0_term[k], fresnel_term[k])
            for i in range(listed):
                peaks[narrow[i]] = 0
