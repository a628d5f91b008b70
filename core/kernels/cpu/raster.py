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
from .reductions import totals
from .simd import bits, first_bit, load, minimum, prefetch, ramp, select, splat, store
from .simd_math import bounded_exp

_AHEAD = 4  # entries between the prefetch of a splat and its use: splats are scattered in memory, outside the L1 cache
_PIXELS = TILE * TILE
_COMMON = 6  # features that all splats have, colour and normal: a loop of known length is unrolled
_GEOMETRY_AND_COMMON = (SPLAT_GRADIENTS + _COMMON) * 8  # floats of their sums


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
def _fetch(record, feature, g):
    """Prefetch a splat's record and features."""
    prefetch(record, g, 0)
    prefetch(record, g, SPLAT_RECORD - 1)
    prefetch(feature, g, 0)
    prefetch(feature, g, feature.shape[1] - 1)


@helper
def _rows(box, g, y0, open_rows):
    """Return the rows of a tile that a splat's box covers, as bits, of those in `open_rows`."""
    first, last = max(box[g, 1] - y0, 0), min(box[g, 3] - y0, TILE - 1)
    return open_rows & np.uint64((1 << (last + 1)) - (1 << first))


@kernel
def rasterize_range(
    begin, end, start, entries, record, feature, box, columns, image, stride, plane, hits, hit_rows, hit_count
):  # fmt: skip
    """Composite tiles begin..end into `image`: channel planes of `plane` floats with rows of `stride` floats, flattened.

    hits: (entries,) receives from start[t] on the hit_count[t] splats that contribute to tile t, in their order; bit r of hit_rows
    (entries,) is set where a splat contributes to row r of the tile.
    """
    features = feature.shape[1]
    channels = features + 2
    acc = np.empty(channels * _PIXELS, np.float32)
    transmittance = np.empty(_PIXELS, np.float32)
    for tile in range(begin, end):
        x0, y0 = (tile % columns) * TILE, (tile // columns) * TILE
        acc[:] = 0.0
        transmittance[:] = 1.0
        x = ramp() + (x0 + 0.5)
        found = start[tile]
        open_rows = np.uint64((1 << TILE) - 1)  # rows in which a pixel is not opaque yet
        for entry in range(start[tile], start[tile + 1]):
            if open_rows == 0:
                break
            coming = entries[min(entry + _AHEAD, start[tile + 1] - 1)]
            _fetch(record, feature, coming)
            prefetch(box, coming, 0)
            g = entries[entry]
            dx = x - record[g, 0]
            ax, bx, wx = dx * record[g, 2], dx * record[g, 4], dx * record[g, 6] + 1.0
            low, cut, opacity, z = dx * dx * LOW_PASS, record[g, 10], record[g, 9], record[g, 8]
            rows, hit = _rows(box, g, y0, open_rows), np.uint64(0)
            while rows != 0:
                row = first_bit(rows)
                bit = rows & (~rows + np.uint64(1))
                rows ^= bit
                dy = np.float32(y0 + row + 0.5) - record[g, 1]
                rho, iw, _, _, filtered = _evaluate(record, g, dx, dy, ax, bx, wx, low)
                before = load(transmittance, row * 8)
                mask = (rho <= cut) & (before > TRANSMITTANCE_MIN)
                if bits(mask) == 0:
                    continue
                hit |= bit
                alpha = select(mask, minimum(bounded_exp(minimum(rho, splat(cut)) * -0.5) * opacity, splat(ALPHA_MAX)), splat(0.0))
                weight = alpha * before
                after = before - weight
                store(transmittance, row * 8, after)
                if bits(after > TRANSMITTANCE_MIN) == 0:
                    open_rows ^= bit
                for channel in range(_COMMON):
                    at = channel * _PIXELS + row * 8
                    store(acc, at, load(acc, at) + weight * feature[g, channel])
                for channel in range(_COMMON, features):
                    at = channel * _PIXELS + row * 8
                    store(acc, at, load(acc, at) + weight * feature[g, channel])
                at = features * _PIXELS + row * 8
                store(acc, at, load(acc, at) + weight * select(filtered, splat(z), iw * z))
            hits[found], hit_rows[found] = g, hit
            found += hit != 0
        hit_count[tile] = found - start[tile]
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


@helper
def _add_sums(out, touched, g, sums):
    """Add the lanes of each vector in `sums` (W * 8,) to row g of `out` (N * W,); a row that was not touched is overwritten."""
    width = len(sums) // 8
    for first in range(0, width, 8):
        at = first * 8
        value = totals(
            load(sums, at), load(sums, at + 8), load(sums, at + 16), load(sums, at + 24),
            load(sums, at + 32), load(sums, at + 40), load(sums, at + 48), load(sums, at + 56),
        )  # fmt: skip
        at = g * width + first
        store(out, at, load(out, at) + value if touched[g] else value)
    touched[g] = 1


@kernel
def rasterize_backward_range(
    slot, begin, end, start, hits, hit_rows, hit_count, record, feature, columns, image, gradient, stride, plane, slots, touched
):  # fmt: skip
    """Compute the adjoint of `rasterize_range`: add gradients of records and features to slots[slot] (N, W).

    slots: (threads, N, W); W is SPLAT_GRADIENTS + F, rounded up to whole vectors. touched: zeros (threads, N); set for the rows of `slots`
    that hold a gradient, the others stay as they are.
    """
    features = feature.shape[1]
    channels = features + 2
    g_tile = np.empty(channels * _PIXELS, np.float32)
    s_total, s_run, transmittance = np.empty(_PIXELS, np.float32), np.empty(_PIXELS, np.float32), np.empty(_PIXELS, np.float32)
    sums = np.zeros(slots.shape[2] * 8, np.float32)
    out, mine = slots[slot].reshape(-1), touched[slot]
    zero = splat(0.0)
    for tile in range(begin, end):
        if hit_count[tile] == 0:
            continue
        x0, y0 = (tile % columns) * TILE, (tile // columns) * TILE
        _load_gradients(gradient, image, stride, plane, x0, y0, channels, g_tile, s_total)
        s_run[:] = 0.0
        transmittance[:] = 1.0
        x = ramp() + (x0 + 0.5)
        last = start[tile] + hit_count[tile] - 1
        for entry in range(start[tile], last + 1):
            coming = hits[min(entry + _AHEAD, last)]
            _fetch(record, feature, coming)
            prefetch(slots[slot], coming, 0)
            prefetch(slots[slot], coming, slots.shape[2] - 1)
            g, left = hits[entry], np.uint64(hit_rows[entry])
            dx = x - record[g, 0]
            ax, bx, wx = dx * record[g, 2], dx * record[g, 4], dx * record[g, 6] + 1.0
            low, cut, opacity, z = dx * dx * LOW_PASS, record[g, 10], record[g, 9], record[g, 8]
            r2, r3, r4, r5, r6, r7 = record[g, 2], record[g, 3], record[g, 4], record[g, 5], record[g, 6], record[g, 7]
            # Sums over rows of the gradients of u, v, w and the low-pass filter's rho; dx is the same in all rows.
            su, sv, sw, sf, su_y, sv_y, sw_y, sf_y, gz, go = zero, zero, zero, zero, zero, zero, zero, zero, zero, zero
            f0, f1, f2, f3, f4, f5 = zero, zero, zero, zero, zero, zero
            sums[_GEOMETRY_AND_COMMON : (SPLAT_GRADIENTS + features) * 8] = 0.0
            while left != 0:
                row = first_bit(left)
                left &= left - np.uint64(1)
                dy = np.float32(y0 + row + 0.5) - record[g, 1]
                rho, iw, u, v, filtered = _evaluate(record, g, dx, dy, ax, bx, wx, low)
                before = load(transmittance, row * 8)
                mask = (rho <= cut) & (before > TRANSMITTANCE_MIN)
                bell = bounded_exp(minimum(rho, splat(cut)) * -0.5)
                raw = bell * opacity
                alpha = select(mask, minimum(raw, splat(ALPHA_MAX)), zero)
                weight = alpha * before
                store(transmittance, row * 8, before - weight)
                depth = iw * z
                gd = load(g_tile, features * _PIXELS + row * 8)
                q = load(g_tile, (features + 1) * _PIXELS + row * 8) + gd * select(filtered, splat(z), depth)
                g0, g1, g2 = load(g_tile, row * 8), load(g_tile, _PIXELS + row * 8), load(g_tile, 2 * _PIXELS + row * 8)
                g3, g4, g5 = load(g_tile, 3 * _PIXELS + row * 8), load(g_tile, 4 * _PIXELS + row * 8), load(g_tile, 5 * _PIXELS + row * 8)
                q = q + g0 * feature[g, 0] + g1 * feature[g, 1] + g2 * feature[g, 2]
                q = q + g3 * feature[g, 3] + g4 * feature[g, 4] + g5 * feature[g, 5]
                f0, f1, f2, f3, f4, f5 = (
                    f0 + weight * g0,
                    f1 + weight * g1,
                    f2 + weight * g2,
                    f3 + weight * g3,
                    f4 + weight * g4,
                    f5 + weight * g5,
                )
                for channel in range(_COMMON, features):
                    gc = load(g_tile, channel * _PIXELS + row * 8)
                    q = q + gc * feature[g, channel]
                    at = (SPLAT_GRADIENTS + channel) * 8
                    store(sums, at, load(sums, at) + weight * gc)
                run = load(s_run, row * 8) + weight * q
                store(s_run, row * 8, run)
                g_alpha = before * q - (load(s_total, row * 8) - run) / (1.0 - alpha)
                g_alpha = select(mask & (raw < ALPHA_MAX), g_alpha, zero)
                go = go + g_alpha * bell
                g_rho = g_alpha * alpha
                gt = weight * gd
                nearer = gt * iw
                gz = gz + select(filtered, gt, nearer)
                g_flat, g_uv = select(filtered, g_rho, zero), select(filtered, zero, g_rho * iw)
                gu, gv = g_uv * u, g_uv * v
                gw = gu * u + gv * v - select(filtered, zero, nearer * depth)
                su, sv, sw, sf = su + gu, sv + gv, sw + gw, sf + g_flat
                su_y, sv_y, sw_y, sf_y = su_y + gu * dy, sv_y + gv * dy, sw_y + gw * dy, sf_y + g_flat * dy
            gmx = su * r2 + sv * r4 - sw * r6 + sf * dx * LOW_PASS
            gmy = su * r3 + sv * r5 - sw * r7 + sf_y * LOW_PASS
            geometry = (gmx, gmy, su * dx * -1.0, su_y * -1.0, sv * dx * -1.0, sv_y * -1.0, sw * dx, sw_y, gz, go, f0, f1, f2, f3, f4, f5)
            for j in range(SPLAT_GRADIENTS + _COMMON):
                store(sums, j * 8, geometry[j])
            _add_sums(out, mine, g, sums)
