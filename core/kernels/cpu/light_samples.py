# SPDX-License-Identifier: GPL-3.0-or-later
"""Light samples at surface points, drawn from a table of the light's directions; called by core/relight/direct_light.py.

Samples in directions known to be unoccluded are summed at once, the others are traced first. They bring only the light itself; light
reflected by surfaces in the way is summed by core/kernels/cpu/gathering.py. `survey_range` is called by core/relight/visibility_cache.py.
"""

from __future__ import annotations

import math

import numpy as np

from ..constants import LEAST_ALPHA
from .jit import helper, kernel
from .lobes import distribution, half_vector, masking_root
from .reflection import irgs_terms
from .simd import bits, first_bit, load, maximum, prefetch, splat, store

LEAST_ALPHA2 = np.float32(LEAST_ALPHA * LEAST_ALPHA)
_ZERO, _ONE, _HALF, _INVERSE_PI = np.float32(0.0), np.float32(1.0), np.float32(0.5), np.float32(1 / math.pi)


@helper
def bin_of(x, y, z, bins):
    """Return which of the bins x bins squares of the octahedral map contains a direction."""
    scale = 1 / (abs(x) + abs(y) + abs(z))
    s, t = x * scale, y * scale
    if z < 0:
        s, t = math.copysign(1 - abs(t), s), math.copysign(1 - abs(s), t)
    column, row = int((s * 0.5 + 0.5) * bins), int((t * 0.5 + 0.5) * bins)
    return max(min(row, bins - 1), 0) * bins + max(min(column, bins - 1), 0)


@helper
def _place(points, shift_u, shift_v, table, entry):
    """Write to `entry` (n_e,) the places in the table (T^2, 7) of a point's samples, and prefetch them: it lies outside the L1 cache."""
    size = int(math.sqrt(len(table)))
    for i in range(len(points)):
        across, down = points[i, 0] + shift_u, points[i, 1] + shift_v
        across, down = across - (across >= 1), down - (down >= 1)
        entry[i] = int(down * size) * size + int(across * size)
        prefetch(table, entry[i], 0)
        prefetch(table, entry[i], 6)


@helper
def _draw(entry, first, cosine, sine, table, lanes):
    """Write up to 8 samples from `first` on to `lanes` (56,): x, y, z, density and radiance.

    Lanes without a sample have the direction 0, which is above no horizon.
    """
    for lane in range(8):
        if first + lane >= len(entry):
            lanes[lane], lanes[8 + lane], lanes[16 + lane], lanes[24 + lane] = _ZERO, _ZERO, _ZERO, _ONE
            continue
        at = entry[first + lane]
        x, y = table[at, 0], table[at, 1]
        lanes[lane], lanes[8 + lane] = cosine * x - sine * y, sine * x + cosine * y
        for j in range(2, 7):
            lanes[j * 8 + lane] = table[at, j]


@helper
def _mark_clear(lanes, left, clear, tile, bins, free):
    """Write to `free` (8,) 1 where the direction of a lane in the bits `left` is known to be unoccluded, else 0."""
    free[:] = _ZERO
    while left != 0:
        lane = first_bit(np.uint64(left))
        left &= left - np.uint32(1)
        free[lane] = np.float32(clear[tile, bin_of(lanes[lane], lanes[8 + lane], lanes[16 + lane], bins)])


@helper
def _irgs_lanes(nx, ny, nz, vx, vy, vz, n_v, own2, lanes, n_l, value, bias):
    """Write the parts of IRGS' lobe in the directions of the lanes, times n.l, to `value` and `bias` (8,)."""
    for lane in range(8):
        scaled = irgs_terms(nx, ny, nz, vx, vy, vz, lanes[lane], lanes[8 + lane], lanes[16 + lane], n_l[lane], n_v, own2)
        value[lane], bias[lane] = scaled[0] * n_l[lane], scaled[1] * n_l[lane]


@helper
def _add_halves(lanes, sums, p):
    """Add the 12 vectors of `lanes` (96,), lanes of even samples to the first half and the others to the second, to sums (P, 2, 12)."""
    for channel in range(12):
        at = channel * 8
        sums[p, 0, channel] += (lanes[at] + lanes[at + 2]) + (lanes[at + 4] + lanes[at + 6])
        sums[p, 1, channel] += (lanes[at + 1] + lanes[at + 3]) + (lanes[at + 5] + lanes[at + 7])


@kernel
def light_range(
    number, begin, end, view, normal, origin, alpha, shift, points, n_c, n_g, table, turn, tile, clear, bins, irgs, sums, sample, start,
    direction, weights, made
):  # fmt: skip
    """Draw the light samples above the horizon of points begin..end, 8 at a time, and sum those in unoccluded directions.

    points: (n_e, 2) in [0, 1), shifted for each point. n_c, n_g: cosine and visible-normal samples that share the balance heuristic.
    irgs: True for the lobe of IRGS' BRDF, whose alpha has no lower bound; that of the visible-normal samples has one.
    table: (T, T, 7) direction, density and radiance over the unit square of the light's distribution; turn: rotation, fraction of a turn.
    tile: (P,) row of `clear` (tiles, bins^2), which marks unoccluded directions; samples there are added to `sums` (P, 2, 12) at once.
    made: (ranges, 2) receives the number of samples above the horizon and of those to be traced. The latter are written from row
    begin n_e on: sample (.., 3) point, half, entry of the table; start and direction (.., 3) of the ray; weights (.., 3) of the lobes.
    """
    n_e, entries = len(points), table.reshape(-1, 7)
    cosine, sine = np.float32(math.cos(2 * math.pi * turn)), np.float32(math.sin(2 * math.pi * turn))
    lanes, sent, acc = np.zeros(56, np.float32), np.zeros(24, np.float32), np.empty(96, np.float32)
    free, cosines = np.zeros(8, np.float32), np.zeros(8, np.float32)
    entry, coming = np.zeros(n_e, np.int64), np.zeros(n_e, np.int64)  # places of this point's samples, and of the next one's
    zero, to, above = splat(_ZERO), begin * n_e, 0
    for p in range(begin, end):
        nx, ny, nz, vx, vy, vz = normal[p, 0], normal[p, 1], normal[p, 2], view[p, 0], view[p, 1], view[p, 2]
        n_v, own2 = nx * vx + ny * vy + nz * vz, alpha[p] * alpha[p]
        a2 = max(own2, LEAST_ALPHA2)
        root_v = masking_root(n_v, a2)
        masked = np.float32(n_g) * _HALF / (n_v + root_v)
        acc[:] = _ZERO
        if p == begin:
            _place(points, shift[p, 0], shift[p, 1], entries, coming)
        entry, coming = coming, entry
        after = min(p + 1, end - 1)
        _place(points, shift[after, 0], shift[after, 1], entries, coming)
        for first in range(0, n_e, 8):
            _draw(entry, first, cosine, sine, entries, lanes)
            dx, dy, dz = load(lanes, 0), load(lanes, 8), load(lanes, 16)
            n_l = dx * nx + dy * ny + dz * nz
            left = bits(n_l > zero)
            if left == 0:
                continue
            n_l = maximum(n_l, zero)
            sine2, fresnel = half_vector(vx, vy, vz, nx, ny, nz, n_v, dx, dy, dz, n_l)
            value, k = distribution(sine2, n_l, n_v, root_v, a2)
            # D in the density of visible normals is that of the lobe without its factor V.
            q = load(lanes, 24) * np.float32(n_e) + n_l * (np.float32(n_c) * _INVERSE_PI) + (masked * a2 * _INVERSE_PI) / (k * k)
            bias = value * fresnel
            value = value - bias
            if irgs:
                store(cosines, 0, n_l)
                _irgs_lanes(nx, ny, nz, vx, vy, vz, n_v, own2, lanes, cosines, sent, free)
                value, bias = load(sent, 0), load(free, 0)
            inverse = _ONE / q
            weight, value, bias = n_l * inverse, value * inverse, bias * inverse
            _mark_clear(lanes, left, clear, tile[p], bins, free)
            seen = load(free, 0)
            for channel in range(3):
                light = load(lanes, 32 + channel * 8)
                at = channel * 8
                store(acc, at + 72, load(acc, at + 72) + weight * light)
                light = light * seen
                store(acc, at, load(acc, at) + weight * light)
                store(acc, at + 24, load(acc, at + 24) + value * light)
                store(acc, at + 48, load(acc, at + 48) + bias * light)
            store(sent, 0, weight)
            store(sent, 8, value)
            store(sent, 16, bias)
            while left != 0:
                lane = first_bit(np.uint64(left))
                left &= left - np.uint32(1)
                above += 1
                if free[lane] > _ZERO:
                    continue
                sample[to, 0], sample[to, 1], sample[to, 2] = p, lane & 1, entry[first + lane]
                for axis in range(3):
                    start[to, axis], direction[to, axis] = origin[p, axis], lanes[axis * 8 + lane]
                    weights[to, axis] = sent[axis * 8 + lane]
                to += 1
        _add_halves(acc, sums, p)
    made[number, 0], made[number, 1] = above, to - begin * n_e


@helper
def _add(sums, p, half, weight, value, bias, r, g, b):
    """Add arriving light r, g, b to a point's sums of the three lobes."""
    sums[p, half, 0] += weight * r
    sums[p, half, 1] += weight * g
    sums[p, half, 2] += weight * b
    sums[p, half, 3] += value * r
    sums[p, half, 4] += value * g
    sums[p, half, 5] += value * b
    sums[p, half, 6] += bias * r
    sums[p, half, 7] += bias * g
    sums[p, half, 8] += bias * b


@kernel
def settle_range(begin, end, sample, weights, hidden, table, sums):
    """Add the light of traced samples begin..end, of which the fraction `hidden` in 0..1 is occluded, to `sums` (P, 2, 12).

    sample, weights: rows from `begin` on belong to these samples. hidden: (end - begin,). table: see `light_range`.
    """
    size = table.shape[1]
    for i in range(begin, end):
        row, column, free = sample[i, 2] // size, sample[i, 2] % size, 1 - float(hidden[i - begin])
        r, g, b = free * float(table[row, column, 4]), free * float(table[row, column, 5]), free * float(table[row, column, 6])
        _add(sums, sample[i, 0], sample[i, 1], float(weights[i, 0]), float(weights[i, 1]), float(weights[i, 2]), r, g, b)


@kernel
def survey_range(begin, end, direction, terms, row, tile, bins, seen, met):
    """Count all rays and the rays with a hit of points begin..end, by tile and direction, in `seen` and `met` (tiles, bins^2).

    direction: (P, M, 3); terms: see `terms_range`; row: (P, M), -1 for rays without a hit. Run one range at a time: tiles are shared.
    """
    for p in range(begin, end):
        for i in range(direction.shape[1]):
            if terms[p, i, 2] <= 0:
                continue
            at = bin_of(float(direction[p, i, 0]), float(direction[p, i, 1]), float(direction[p, i, 2]), bins)
            seen[tile[p], at] += 1
            met[tile[p], at] += row[p, i] >= 0
