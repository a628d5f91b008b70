# SPDX-License-Identifier: GPL-3.0-or-later
"""Tile rasteriser of 2D Gaussians: front-to-back compositing, a tile row of 8 pixels to a vector.

Channels of an image: the features of the splats, then depth, then opacity, then the transmittance at which compositing stopped.
A pixel whose transmittance falls to TRANSMITTANCE_MIN counts as opaque: its sums are divided by the sum of the weights and its
opacity is 1. Otherwise the last per cent would leak through to the far side and pull the mean depth behind the surface.

The adjoint runs front to back as well: with q_i = g . c_i and the running sum S_i = sum_{j<=i} w_j q_j,

    dL/dalpha_i = T_i q_i - (S_total - S_i) / (1 - alpha_i),

where S_total = g . C is known from the image. In an opaque pixel C = sum(w c) / sum(w), so that q_i = (g . c_i - g . C) / sum(w)
and S_total = 0.
"""

from __future__ import annotations

import numpy as np

from ..constants import ALPHA_MAX, HORIZON_MIN, LOW_PASS, SPLAT_GRADIENTS, SPLAT_RECORD, TILE, TRANSMITTANCE_MIN
from .jit import helper, kernel
from .simd import bits, exp, load, minimum, prefetch, ramp, select, splat, store, total

_AHEAD = 4  # entries between the prefetch of a splat and its use: splats are scattered in memory, outside the L1 cache
_PIXELS = TILE * TILE


@helper
def _evaluate(record, g, dx, dy, ax, bx, wx, low):
    """Intersect the rays of a tile row with a surfel: return rho, 1/w, u, v and a mask where the low-pass filter's rho is smaller."""
    w = wx + record[g, 7] * dy
    ahead = w > HORIZON_MIN
    iw = 1.0 / select(ahead, w, splat(1.0))
    u = (ax + record[g, 3] * dy) * iw
    v = (bx + record[g, 5] * dy) * iw
    rho = select(ahead, u * u + v * v, splat(1e9))
    flat = low + LOW_PASS * dy * dy
    return minimum(rho, flat), iw, u, v, rho > flat


@helper
def _exhausted(transmittance):
    """Return True where all pixels of a tile are opaque."""
    for row in range(TILE):  # noqa: SIM110  (numba has no all())
        if bits(load(transmittance, row * 8) > TRANSMITTANCE_MIN) != 0:
            return False
    return True


@helper
def _fetch(record, feature, box, g):
    """Prefetch a splat's record, box and features."""
    prefetch(record, g, 0)
    prefetch(record, g, SPLAT_RECORD - 1)
    prefetch(box, g, 0)
    prefetch(feature, g, 0)
    prefetch(feature, g, feature.shape[1] - 1)


@kernel
def rasterize_range(begin, end, start, entries, record, feature, box, columns, image, stride, plane):
    """Composite tiles begin..end into `image`: channel planes of `plane` floats with rows of `stride` floats, flattened."""
    features = feature.shape[1]
    channels = features + 2
    acc = np.empty(channels * _PIXELS, np.float32)
    transmittance = np.empty(_PIXELS, np.float32)
    for tile in range(begin, end):
        x0, y0 = (tile % columns) * TILE, (tile // columns) * TILE
        acc[:] = 0.0
        transmittance[:] = 1.0
        x = ramp() + (x0 + 0.5)
        for entry in range(start[tile], start[tile + 1]):
            if (entry - start[tile]) % 8 == 7 and _exhausted(transmittance):
                break
            coming = entries[min(entry + _AHEAD, start[tile + 1] - 1)]
            _fetch(record, feature, box, coming)
            g = entries[entry]
            dx = x - record[g, 0]
            ax, bx, wx = dx * record[g, 2], dx * record[g, 4], dx * record[g, 6] + 1.0
            low, cut, opacity, z = dx * dx * LOW_PASS, record[g, 10], record[g, 9], record[g, 8]
            for row in range(max(box[g, 1] - y0, 0), min(box[g, 3] - y0, TILE - 1) + 1):
                dy = np.float32(y0 + row + 0.5) - record[g, 1]
                rho, iw, _, _, filtered = _evaluate(record, g, dx, dy, ax, bx, wx, low)
                before = load(transmittance, row * 8)
                mask = (rho <= cut) & (before > TRANSMITTANCE_MIN)
                if bits(mask) == 0:
                    continue
                alpha = select(mask, minimum(exp(rho * -0.5) * opacity, splat(ALPHA_MAX)), splat(0.0))
                weight = alpha * before
                store(transmittance, row * 8, before - weight)
                for channel in range(features):
                    at = channel * _PIXELS + row * 8
                    store(acc, at, load(acc, at) + weight * feature[g, channel])
                at = features * _PIXELS + row * 8
                store(acc, at, load(acc, at) + weight * select(filtered, splat(z), iw * z))
        for row in range(TILE):
            at = (y0 + row) * stride + x0
            left = load(transmittance, row * 8)
            opaque = left <= TRANSMITTANCE_MIN
            scale = select(opaque, 1.0 / (1.0 - left), splat(1.0))
            for channel in range(channels - 1):
                store(image, channel * plane + at, load(acc, channel * _PIXELS + row * 8) * scale)
            store(image, (channels - 1) * plane + at, select(opaque, splat(1.0), 1.0 - left))
            store(image, channels * plane + at, left)


@helper
def _load_gradients(gradient, image, stride, plane, x0, y0, channels, g_tile, s_total):
    """Gather a tile's upstream gradients as gradients of the plain sums, g_tile; s_total = g . C per pixel, 0 where opaque."""
    for row in range(TILE):
        at = (y0 + row) * stride + x0
        left = load(image, channels * plane + at)
        opaque = left <= TRANSMITTANCE_MIN
        scale = select(opaque, 1.0 / (1.0 - left), splat(1.0))
        s = splat(0.0)
        for channel in range(channels - 1):
            g = load(gradient, channel * plane + at)
            store(g_tile, channel * _PIXELS + row * 8, g * scale)
            s = s + g * load(image, channel * plane + at)
        g = load(gradient, (channels - 1) * plane + at)
        store(g_tile, (channels - 1) * _PIXELS + row * 8, select(opaque, s * scale * -1.0, g))
        store(s_total, row * 8, select(opaque, splat(0.0), s + g * (1.0 - left)))


@kernel
def rasterize_backward_range(
    slot, begin, end, start, entries, record, feature, box, columns, image, gradient, stride, plane, slots
):  # fmt: skip
    """Compute the adjoint of `rasterize_range`: add gradients of records and features to slots[slot] (N, SPLAT_GRADIENTS + F)."""
    features = feature.shape[1]
    channels = features + 2
    g_tile = np.empty(channels * _PIXELS, np.float32)
    s_total, s_run, transmittance = np.empty(_PIXELS, np.float32), np.empty(_PIXELS, np.float32), np.empty(_PIXELS, np.float32)
    g_feature = np.empty(features * 8, np.float32)
    out = slots[slot]
    zero = splat(0.0)
    for tile in range(begin, end):
        x0, y0 = (tile % columns) * TILE, (tile // columns) * TILE
        _load_gradients(gradient, image, stride, plane, x0, y0, channels, g_tile, s_total)
        s_run[:] = 0.0
        transmittance[:] = 1.0
        x = ramp() + (x0 + 0.5)
        for entry in range(start[tile], start[tile + 1]):
            if (entry - start[tile]) % 8 == 7 and _exhausted(transmittance):
                break
            coming = entries[min(entry + _AHEAD, start[tile + 1] - 1)]
            _fetch(record, feature, box, coming)
            prefetch(out, coming, 0)
            prefetch(out, coming, out.shape[1] - 1)
            g = entries[entry]
            dx = x - record[g, 0]
            ax, bx, wx = dx * record[g, 2], dx * record[g, 4], dx * record[g, 6] + 1.0
            low, cut, opacity, z = dx * dx * LOW_PASS, record[g, 10], record[g, 9], record[g, 8]
            g_feature[:] = 0.0
            gmx, gmy, ga0, ga1, gb0, gb1, gc0, gc1, gz, go = zero, zero, zero, zero, zero, zero, zero, zero, zero, zero
            touched = False
            for row in range(max(box[g, 1] - y0, 0), min(box[g, 3] - y0, TILE - 1) + 1):
                dy = np.float32(y0 + row + 0.5) - record[g, 1]
                rho, iw, u, v, filtered = _evaluate(record, g, dx, dy, ax, bx, wx, low)
                before = load(transmittance, row * 8)
                mask = (rho <= cut) & (before > TRANSMITTANCE_MIN)
                if bits(mask) == 0:
                    continue
                touched = True
                bell = exp(rho * -0.5)
                raw = bell * opacity
                alpha = select(mask, minimum(raw, splat(ALPHA_MAX)), zero)
                weight = alpha * before
                store(transmittance, row * 8, before - weight)
                depth = select(filtered, splat(z), iw * z)
                gd = load(g_tile, features * _PIXELS + row * 8)
                q = load(g_tile, (features + 1) * _PIXELS + row * 8) + gd * depth
                for channel in range(features):
                    gc = load(g_tile, channel * _PIXELS + row * 8)
                    q = q + gc * feature[g, channel]
                    store(g_feature, channel * 8, load(g_feature, channel * 8) + weight * gc)
                run = load(s_run, row * 8) + weight * q
                store(s_run, row * 8, run)
                g_alpha = before * q - (load(s_total, row * 8) - run) / (1.0 - alpha)
                g_alpha = select(mask & (raw < ALPHA_MAX), g_alpha, zero)
                go = go + g_alpha * bell
                g_rho = g_alpha * alpha * -0.5
                gt = weight * gd
                g_flat = select(filtered, g_rho * (2.0 * LOW_PASS), zero)
                g_uv = select(filtered, zero, g_rho * iw * 2.0)
                gu, gv = g_uv * u, g_uv * v
                gw = (select(filtered, zero, gt * iw * iw * z) + gu * u + gv * v) * -1.0
                gz = gz + select(filtered, gt, gt * iw)
                gmx = gmx - (gu * record[g, 2] + gv * record[g, 4] + gw * record[g, 6] + g_flat * dx)
                gmy = gmy - (gu * record[g, 3] + gv * record[g, 5] + gw * record[g, 7] + g_flat * dy)
                ga0, gb0, gc0 = ga0 + gu * dx, gb0 + gv * dx, gc0 + gw * dx
                ga1, gb1, gc1 = ga1 + gu * dy, gb1 + gv * dy, gc1 + gw * dy
            if touched:
                sums = (gmx, gmy, ga0, ga1, gb0, gb1, gc0, gc1, gz, go)
                for j in range(SPLAT_GRADIENTS):
                    out[g, j] += total(sums[j])
                for channel in range(features):
                    out[g, SPLAT_GRADIENTS + channel] += total(load(g_feature, channel * 8))
