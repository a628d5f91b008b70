# SPDX-License-Identifier: GPL-3.0-or-later
"""Weighted sums of radiance and attributes over hit lists, and their adjoint.

The row of a Gaussian holds its SH coefficients (3 x 16, channel by channel; none without SH), then its extra channels, padded to whole
vectors.
"""

from __future__ import annotations

import numpy as np

from ..constants import BEHIND, NORMAL, TRANSMITTANCE_MIN
from .harmonics import basis
from .jit import helper, kernel
from .reductions import total
from .simd import load, prefetch, store

SH_ROW = 48
SUMS = 8  # outputs besides the extras: colour, normal, distance, opacity
_AHEAD = 4  # hits between the prefetch of a row and its use


@kernel
def pack_range(begin, end, sh, extra, coefficients, n, rows):
    """Write flat parameters (K, 3, N), (E, N) to rows (N, width) of Gaussians begin..end, padded with zeros."""
    offset = SH_ROW if coefficients > 0 else 0
    extras = len(extra) // n
    for start in range(begin, end, 64):  # blocks that stay in the L1 cache
        stop = min(start + 64, end)
        rows[start:stop] = np.float32(0.0)
        for j in range(coefficients):
            for channel in range(3):
                for g in range(start, stop):
                    rows[g, channel * 16 + j] = sh[(j * 3 + channel) * n + g]
        for j in range(extras):
            for g in range(start, stop):
                rows[g, offset + j] = extra[j * n + g]


@kernel
def unpack_range(begin, end, slots, coefficients, n, g_sh, g_extra):
    """Compute the adjoint of `pack_range`: sum the threads' slots (threads, N, >= width) in their order into flat g_sh, g_extra."""
    offset = SH_ROW if coefficients > 0 else 0
    extras = len(g_extra) // n
    for start in range(begin, end, 64):
        stop = min(start + 64, end)
        for j in range(coefficients * 3 + extras):
            column = j % 3 * 16 + j // 3 if j < coefficients * 3 else offset + j - coefficients * 3
            for g in range(start, stop):
                value = np.float32(0.0)
                for slot in range(len(slots)):
                    value += slots[slot, g, column]
                if j < coefficients * 3:
                    g_sh[j * n + g] = value
                else:
                    g_extra[(j - coefficients * 3) * n + g] = value


@helper
def spread_basis(direction, ray, end, coefficients, axes, values, spread):
    """Write the SH basis of up to 8 rays from `ray` on, 16 floats per ray, to spread (128,); leave the directions in `axes` (24,)."""
    for lane in range(8):
        for axis in range(3):
            axes[axis * 8 + lane] = direction[3 * min(ray + lane, end - 1) + axis]
    basis(load(axes, 0), load(axes, 8), load(axes, 16), coefficients, values)
    for lane in range(8):
        for j in range(coefficients):
            spread[lane * 16 + j] = values[j * 8 + lane]


@helper
def radiance(rows, at, channel, low, high):
    """Return one channel of a Gaussian's radiance before its clamp, in the direction whose SH basis is `low`, `high`."""
    return total(load(rows, at + channel * 16) * low + load(rows, at + channel * 16 + 8) * high) + np.float32(0.5)


@helper
def facing(record, g, dx, dy, dz):
    """Return 1, or -1 where the ray meets a Gaussian from behind, so that its normal is flipped."""
    cosine = record[g, NORMAL] * dx + record[g, NORMAL + 1] * dy + record[g, NORMAL + 2] * dz
    return np.float32(-1.0) if cosine > BEHIND else np.float32(1.0)


@kernel
def composite_range(begin, end, direction, start, index, weight, distance, left, record, rows, coefficients, extras, out, lit):
    """Sum rows over the hits of rays begin..end to out (R, SUMS + E).

    lit: (H,) receives a mask per hit; bit c is set where the clamp let colour channel c pass.
    """
    width = rows.shape[1]
    offset = SH_ROW if coefficients > 0 else 0
    row = rows.reshape(-1)
    axes, values, spread = np.zeros(24, np.float32), np.zeros(128, np.float32), np.zeros(128, np.float32)
    acc = np.empty(max(width - offset, 8), np.float32)
    zero = np.float32(0.0)
    block = -1  # first ray of the 8 whose basis is in `spread`
    for ray in range(begin, end):
        if start[ray] == start[ray + 1]:
            out[ray] = zero
            continue
        lane = (ray - begin) % 8
        if coefficients > 0 and ray - lane != block:
            block = ray - lane
            spread_basis(direction, block, end, coefficients, axes, values, spread)
        low, high = load(spread, lane * 16), load(spread, lane * 16 + 8)
        dx, dy, dz = direction[3 * ray], direction[3 * ray + 1], direction[3 * ray + 2]
        red, green, blue, nx, ny, nz, depth, opacity = zero, zero, zero, zero, zero, zero, zero, zero
        acc[:] = zero
        for hit in range(start[ray], start[ray + 1]):
            coming = index[min(hit + _AHEAD, len(index) - 1)]
            for line in range(0, width, 16):
                prefetch(rows, coming, line)
            g, w = index[hit], weight[hit]
            at = g * width
            if coefficients > 0:
                r, gr, b = radiance(row, at, 0, low, high), radiance(row, at, 1, low, high), radiance(row, at, 2, low, high)
                red, green, blue = red + w * max(r, zero), green + w * max(gr, zero), blue + w * max(b, zero)
                lit[hit] = (r > zero) + 2 * (gr > zero) + 4 * (b > zero)
            for j in range(0, width - offset, 8):
                store(acc, j, load(acc, j) + load(row, at + offset + j) * w)
            turned = w * facing(record, g, dx, dy, dz)
            nx, ny, nz = nx + turned * record[g, NORMAL], ny + turned * record[g, NORMAL + 1], nz + turned * record[g, NORMAL + 2]
            depth += w * distance[hit]
            opacity += w
        out[ray, 0], out[ray, 1], out[ray, 2] = red, green, blue
        out[ray, 3], out[ray, 4], out[ray, 5] = nx, ny, nz
        for j in range(extras):
            out[ray, 6 + j] = acc[j]
        out[ray, 6 + extras] = depth
        out[ray, 7 + extras] = np.float32(1.0) if left[ray] <= np.float32(TRANSMITTANCE_MIN) else opacity


@kernel
def composite_backward_range(slot, begin, end, direction, start, index, weight, lit, coefficients, extras, gradient, slots):
    """Compute the adjoint of `composite_range` for the rows alone: add to slots[slot] (N, width)."""
    out = slots[slot].reshape(-1)
    width = slots.shape[2]
    offset = SH_ROW if coefficients > 0 else 0
    axes, values, spread = np.zeros(24, np.float32), np.zeros(128, np.float32), np.zeros(128, np.float32)
    upstream = np.zeros(max(width - offset, 8), np.float32)
    block = -1
    for ray in range(begin, end):
        if start[ray] == start[ray + 1]:
            continue
        lane = (ray - begin) % 8
        if coefficients > 0 and ray - lane != block:
            block = ray - lane
            spread_basis(direction, block, end, coefficients, axes, values, spread)
        low, high = load(spread, lane * 16), load(spread, lane * 16 + 8)
        for j in range(extras):
            upstream[j] = gradient[ray, 6 + j]
        for hit in range(start[ray], start[ray + 1]):
            coming = index[min(hit + _AHEAD, len(index) - 1)]
            for line in range(0, width, 16):
                prefetch(slots[slot], coming, line)
            w, at = weight[hit], index[hit] * width
            if coefficients > 0:
                add_radiance(out, at, low, high, w, gradient, ray, lit[hit])
            for j in range(0, width - offset, 8):
                store(out, at + offset + j, load(out, at + offset + j) + load(upstream, j) * w)


@helper
def add_radiance(out, at, low, high, w, gradient, ray, lit):
    """Add the gradient of a hit's SH coefficients to the row at `at`, for the channels set in `lit`."""
    for channel in range(3):
        if lit >> channel & 1:
            g = w * gradient[ray, channel]
            here = at + channel * 16
            store(out, here, load(out, here) + low * g)
            store(out, here + 8, load(out, here + 8) + high * g)


@kernel
def blend_range(begin, end, ray, start, index, weight, rows, channels, out):
    """Sum rows (N, width) over the hits of the rays ray[begin:end] to out (B, C)."""
    width = rows.shape[1]
    row = rows.reshape(-1)
    acc = np.empty(width, np.float32)
    for b in range(begin, end):
        acc[:] = np.float32(0.0)
        for hit in range(start[ray[b]], start[ray[b] + 1]):
            at, w = index[hit] * width, weight[hit]
            for j in range(0, width, 8):
                store(acc, j, load(acc, j) + load(row, at + j) * w)
        for j in range(channels):
            out[b, j] = acc[j]


@kernel
def blend_backward_range(slot, begin, end, ray, start, index, weight, gradient, slots):
    """Compute the adjoint of `blend_range` for gradient (B, C): add to slots[slot] (N, width)."""
    out = slots[slot].reshape(-1)
    width = slots.shape[2]
    upstream = np.zeros(width, np.float32)
    for b in range(begin, end):
        for j in range(gradient.shape[1]):
            upstream[j] = gradient[b, j]
        for hit in range(start[ray[b]], start[ray[b] + 1]):
            at, w = index[hit] * width, weight[hit]
            for j in range(0, width, 8):
                store(out, at + j, load(out, at + j) + load(upstream, j) * w)
