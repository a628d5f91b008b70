# SPDX-License-Identifier: GPL-3.0-or-later
"""Light samples at surface points, drawn from a table of the light's directions; called by core/relight/direct_light.py.

Samples in directions known to be unoccluded are summed at once, the others are traced first. They bring only the light itself; light
reflected by surfaces in the way is summed by core/kernels/cpu/gathering.py. `survey_range` is called by core/relight/visibility_cache.py.
"""

from __future__ import annotations

import math

from ..constants import LEAST_ALPHA
from .jit import helper, kernel
from .reflection import irgs_terms, point_terms, specular_terms

LEAST_ALPHA2 = LEAST_ALPHA * LEAST_ALPHA


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
def light_range(
    number, begin, end, view, normal, alpha, shift, points, n_c, n_g, table, turn, tile, clear, bins, irgs, sums, sample, direction,
    weights, made
):  # fmt: skip
    """Draw the light samples above the horizon of points begin..end, and sum those in unoccluded directions.

    points: (n_e, 2) in [0, 1), shifted for each point. n_c, n_g: cosine and visible-normal samples that share the balance heuristic.
    irgs: True for the lobe of IRGS' BRDF, whose alpha has no lower bound; that of the visible-normal samples has one.
    table: (T, T, 7) direction, density and radiance over the unit square of the light's distribution; turn: rotation, fraction of a turn.
    tile: (P,) row of `clear` (tiles, bins^2), which marks unoccluded directions; samples there are added to `sums` (P, 2, 12) at once.
    made: (ranges, 2) receives the number of samples above the horizon and of those to be traced. The latter are written from row
    begin n_e on: sample (.., 3) point, half, entry of the table; direction (.., 3); weights (.., 3) of the three lobes.
    """
    n_e, size = len(points), table.shape[0]
    cosine, sine = math.cos(2 * math.pi * turn), math.sin(2 * math.pi * turn)
    to, above = begin * n_e, 0
    for p in range(begin, end):
        (nx, ny, nz), (vx, vy, vz), own2, n_v, root_v = point_terms(view, normal, alpha, p)
        a2 = max(own2, LEAST_ALPHA2)
        if irgs:
            root_v = math.sqrt(n_v * n_v * (1 - a2) + a2)
        masked = 0.5 / (n_v + root_v)
        for i in range(n_e):
            across, down = points[i, 0] + float(shift[p, 0]), points[i, 1] + float(shift[p, 1])
            across, down = across - (across >= 1), down - (down >= 1)
            row, column = int(down * size), int(across * size)
            x, y, dz = float(table[row, column, 0]), float(table[row, column, 1]), float(table[row, column, 2])
            dx, dy = cosine * x - sine * y, sine * x + cosine * y
            n_l = nx * dx + ny * dy + nz * dz
            if n_l <= 0:
                continue
            value, bias = specular_terms(nx, ny, nz, vx, vy, vz, dx, dy, dz, n_l, n_v, root_v, a2)
            # D in the density of visible normals is that of the lobe without its factor 0.5 / sum_l.
            sum_l = n_l * root_v + n_v * math.sqrt(n_l * n_l * (1 - a2) + a2)
            q = n_e * float(table[row, column, 3]) + n_c / math.pi * n_l + n_g * masked * (value + bias) * 2 * sum_l
            if irgs:
                value, bias = irgs_terms(nx, ny, nz, vx, vy, vz, dx, dy, dz, n_l, n_v, own2)
            weight = n_l / q
            value, bias = value * weight, bias * weight
            r, g, b = float(table[row, column, 4]), float(table[row, column, 5]), float(table[row, column, 6])
            half = i & 1
            above += 1
            sums[p, half, 9] += weight * r
            sums[p, half, 10] += weight * g
            sums[p, half, 11] += weight * b
            if clear[tile[p], bin_of(dx, dy, dz, bins)]:
                _add(sums, p, half, weight, value, bias, r, g, b)
                continue
            sample[to, 0], sample[to, 1], sample[to, 2] = p, half, row * size + column
            direction[to, 0], direction[to, 1], direction[to, 2] = dx, dy, dz
            weights[to, 0], weights[to, 1], weights[to, 2] = weight, value, bias
            to += 1
    made[number, 0], made[number, 1] = above, to - begin * n_e


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
