# SPDX-License-Identifier: GPL-3.0-or-later
"""Tile rasteriser in plain scalar loops, for comparison with `core/kernels/cpu/raster.py` and its vector type."""

from __future__ import annotations

import math

import numpy as np
from irgspp.core.kernels.constants import ALPHA_MAX, HORIZON_MIN, LOW_PASS, SPLAT_GRADIENTS, TILE, TRANSMITTANCE_MIN
from irgspp.core.kernels.cpu.jit import helper, kernel

_ONE, _ZERO, _HALF, _FAR = np.float32(1.0), np.float32(0.0), np.float32(0.5), np.float32(1e9)
_LOW, _MAX, _STOP, _BEHIND = np.float32(LOW_PASS), np.float32(ALPHA_MAX), np.float32(TRANSMITTANCE_MIN), np.float32(HORIZON_MIN)


@helper
def _evaluate(record, g, dx, dy):
    """Intersect one pixel's ray with a surfel: rho, 1/w, u, v, and whether the low-pass filter decides."""
    w = _ONE + dx * record[g, 6] + dy * record[g, 7]
    ahead = w > _BEHIND
    iw = _ONE / (w if ahead else _ONE)
    u = (dx * record[g, 2] + dy * record[g, 3]) * iw
    v = (dx * record[g, 4] + dy * record[g, 5]) * iw
    rho = u * u + v * v if ahead else _FAR
    flat = _LOW * (dx * dx + dy * dy)
    return min(rho, flat), iw, u, v, rho > flat


@helper
def _exhausted(transmittance):
    """Return True where every pixel of a tile is opaque."""
    for row in range(TILE):
        for column in range(TILE):
            if transmittance[row, column] > _STOP:
                return False
    return True


@kernel
def plain_range(begin, end, start, entries, record, feature, box, columns, image, stride, plane, hits, hit_rows, hit_count):
    """Rasterise a range of tiles into `image` (channels x plane,) as `rasterize_range` does, one pixel at a time."""
    features = feature.shape[1]
    acc = np.empty((features + 1, TILE, TILE), np.float32)
    transmittance = np.empty((TILE, TILE), np.float32)
    for tile in range(begin, end):
        x0, y0 = (tile % columns) * TILE, (tile // columns) * TILE
        acc[:] = _ZERO
        transmittance[:] = _ONE
        found = start[tile]
        for entry in range(start[tile], start[tile + 1]):
            if (entry - start[tile]) % 8 == 7 and _exhausted(transmittance):
                break
            g, hit = entries[entry], 0
            cut, opacity, z = record[g, 10], record[g, 9], record[g, 8]
            for row in range(max(box[g, 1] - y0, 0), min(box[g, 3] - y0, TILE - 1) + 1):
                dy = np.float32(y0 + row) + _HALF - record[g, 1]
                for column in range(TILE):
                    dx = np.float32(x0 + column) + _HALF - record[g, 0]
                    before = transmittance[row, column]
                    rho, iw, _, _, filtered = _evaluate(record, g, dx, dy)
                    if rho > cut or before <= _STOP:
                        continue
                    hit |= 1 << row
                    weight = min(math.exp(-_HALF * rho) * opacity, _MAX) * before
                    transmittance[row, column] = before - weight
                    for channel in range(features):
                        acc[channel, row, column] += weight * feature[g, channel]
                    acc[features, row, column] += weight * (z if filtered else iw * z)
            hits[found], hit_rows[found] = g, hit
            found += hit != 0
        hit_count[tile] = found - start[tile]
        for row in range(TILE):
            for column in range(TILE):
                at = (y0 + row) * stride + x0 + column
                left = transmittance[row, column]
                opaque = left <= _STOP
                scale = _ONE / (_ONE - left) if opaque else _ONE
                for channel in range(features + 1):
                    image[channel * plane + at] = acc[channel, row, column] * scale
                image[(features + 1) * plane + at] = _ONE if opaque else _ONE - left
                image[(features + 2) * plane + at] = left


@helper
def _load_gradients(gradient, image, stride, plane, x0, y0, channels, g_tile, s_total):
    """Load a tile's upstream gradients (channels, TILE, TILE) as gradients of the plain sums; s_total = g . C per pixel, 0 where opaque."""
    for row in range(TILE):
        for column in range(TILE):
            at = (y0 + row) * stride + x0 + column
            left = image[channels * plane + at]
            opaque = left <= _STOP
            scale = _ONE / (_ONE - left) if opaque else _ONE
            s = _ZERO
            for channel in range(channels - 1):
                g = gradient[channel * plane + at]
                g_tile[channel, row, column] = g * scale
                s += g * image[channel * plane + at]
            g = gradient[(channels - 1) * plane + at]
            g_tile[channels - 1, row, column] = -s * scale if opaque else g
            s_total[row, column] = _ZERO if opaque else s + g * (_ONE - left)


@kernel
def plain_backward_range(
    slot, begin, end, start, hits, hit_rows, hit_count, record, feature, columns, image, gradient, stride, plane, slots, touched
):  # fmt: skip
    """Add the gradients of a range of tiles to `slots` (slots, N, channels) as `rasterize_backward_range` does, one pixel at a time."""
    features = feature.shape[1]
    g_tile = np.empty((features + 2, TILE, TILE), np.float32)
    s_total, s_run = np.empty((TILE, TILE), np.float32), np.empty((TILE, TILE), np.float32)
    transmittance = np.empty((TILE, TILE), np.float32)
    sums = np.empty(SPLAT_GRADIENTS + features, np.float32)
    out = slots[slot]
    for tile in range(begin, end):
        x0, y0 = (tile % columns) * TILE, (tile // columns) * TILE
        _load_gradients(gradient, image, stride, plane, x0, y0, features + 2, g_tile, s_total)
        s_run[:] = _ZERO
        transmittance[:] = _ONE
        for entry in range(start[tile], start[tile] + hit_count[tile]):
            g = hits[entry]
            cut, opacity, z = record[g, 10], record[g, 9], record[g, 8]
            sums[:] = _ZERO
            for row in range(TILE):
                if not hit_rows[entry] >> row & 1:
                    continue
                dy = np.float32(y0 + row) + _HALF - record[g, 1]
                for column in range(TILE):
                    dx = np.float32(x0 + column) + _HALF - record[g, 0]
                    before = transmittance[row, column]
                    rho, iw, u, v, filtered = _evaluate(record, g, dx, dy)
                    if rho > cut or before <= _STOP:
                        continue
                    bell = math.exp(-_HALF * rho)
                    alpha = min(bell * opacity, _MAX)
                    weight = alpha * before
                    transmittance[row, column] = before - weight
                    gd = g_tile[features, row, column]
                    q = g_tile[features + 1, row, column] + gd * (z if filtered else iw * z)
                    for channel in range(features):
                        gc = g_tile[channel, row, column]
                        q += gc * feature[g, channel]
                        sums[SPLAT_GRADIENTS + channel] += weight * gc
                    run = s_run[row, column] + weight * q
                    s_run[row, column] = run
                    g_rho = _ZERO
                    if bell * opacity < _MAX:
                        g_alpha = before * q - (s_total[row, column] - run) / (_ONE - alpha)
                        sums[9] += g_alpha * bell
                        g_rho = -_HALF * g_alpha * alpha
                    gt = weight * gd
                    if filtered:
                        sums[0] -= g_rho * (_LOW + _LOW) * dx
                        sums[1] -= g_rho * (_LOW + _LOW) * dy
                        sums[8] += gt
                        continue
                    gu, gv = (g_rho + g_rho) * iw * u, (g_rho + g_rho) * iw * v
                    gw = -(gt * iw * iw * z + gu * u + gv * v)
                    sums[0] -= gu * record[g, 2] + gv * record[g, 4] + gw * record[g, 6]
                    sums[1] -= gu * record[g, 3] + gv * record[g, 5] + gw * record[g, 7]
                    sums[2] += gu * dx
                    sums[3] += gu * dy
                    sums[4] += gv * dx
                    sums[5] += gv * dy
                    sums[6] += gw * dx
                    sums[7] += gw * dy
                    sums[8] += gt * iw
            if not touched[slot, g]:
                out[g] = _ZERO
            touched[slot, g] = 1
            for j in range(SPLAT_GRADIENTS + features):
                out[g, j] += sums[j]
