# SPDX-License-Identifier: GPL-3.0-or-later
"""Sample directions (cosine, visible normals, light map) with the density of their mixture; called by core/shading/sampling.py.

The reference in PyTorch operations is `_mixture_reference` in the same module.
"""

from __future__ import annotations

import math

import numpy as np

from .jit import helper, kernel

TURN = 2 * math.pi


@helper
def _wrapped(point, shift):
    """Shift a coordinate in [0, 1) by another, on the torus."""
    u = point + float(shift)
    return u - 1 if u >= 1 else u


@helper
def _first_above(table, value, low, high):
    """Return the index of the first entry of ascending table[low:high] greater than `value`, at most `high` - 1."""
    size = high - low
    while size > 1:
        half = size // 2
        low += half * (table[low + half - 1] <= value)
        size -= half
    return low


@helper
def _sample_visible_normal(vx, vy, vz, alpha, u0, u1):
    """Return a local view direction mirrored at a sampled visible normal, by spherical caps (Dupuy and Benyoub 2023)."""
    length = math.sqrt((vx * vx + vy * vy) * alpha * alpha + vz * vz)
    wx, wy, wz = vx * alpha / length, vy * alpha / length, vz / length
    z = (1 - u0) * (1 + wz) - wz
    r, phi = math.sqrt(max(1 - z * z, 0.0)), TURN * u1
    hx, hy, hz = (r * math.cos(np.float32(phi)) + wx) * alpha, (r * math.sin(np.float32(phi)) + wy) * alpha, max(z + wz, 1e-6)
    scale = 2 * (vx * hx + vy * hy + vz * hz) / (hx * hx + hy * hy + hz * hz)
    return scale * hx - vx, scale * hy - vy, scale * hz - vz


@helper
def _sample_light(u0, u1, rows, columns, edges):
    """Sample a world direction by the light map's tables; return it and the flat index of its texel."""
    height = len(rows)
    width = len(columns) // height
    row = _first_above(rows, u1, 0, height)
    before = rows[row - 1] if row > 0 else 0.0
    down = min(max((u1 - before) / (rows[row] - before), 0.0), 1.0)
    flat = _first_above(columns, u0 + row, row * width, row * width + width)
    left = columns[flat - 1] if flat > row * width else float(row)
    across = min(max((u0 + row - left) / (columns[flat] - left), 0.0), 1.0)
    phi = (flat - row * width + across) * (TURN / width)
    z = edges[row] + (edges[row + 1] - edges[row]) * down
    s = math.sqrt(max(1 - z * z, 0.0))
    return -s * math.cos(np.float32(phi)), s * math.sin(np.float32(phi)), z, flat


@helper
def lightmap_place(x, y, z):
    """Return u, v in 0..1 of a unit direction in a lat-long map; compared by `tests/core/shading/test_lightmap_agreement.py`."""
    u = 0.5 - math.atan2(np.float32(y), np.float32(x)) / TURN
    flat2 = x * x + y * y
    if flat2 < 0.01:  # near a pole acos(z) is inaccurate
        return u, math.atan2(np.float32(math.sqrt(flat2)), np.float32(z)) / math.pi
    return u, math.acos(np.float32(min(max(z, -1.0), 1.0))) / math.pi


@helper
def turned(u, turn):
    """Return u in a map rotated by `turn`, a fraction in 0..1 of a full turn."""
    u += turn
    return u - 1 if u >= 1 else u


@helper
def texel_at(u, v, height, width):
    """Return the flat index of the texel that contains u, v; clamped to the map, also for NaN."""
    return max(min(int(v * height), height - 1), 0) * width + max(min(int(u * width), width - 1), 0)


@kernel
def draw_range(begin, end, frame, view, alpha, shift, points_c, points_g, points_e, first, rows, columns, edges, light, direction, density):
    """Draw cosine, visible-normal and light samples, in this order, for points begin..end, from number `first` on.

    Writes `direction` (P, N, 3) and `density` (P, N). frame: (P, 3, 3), columns tangent, bitangent, normal. view: (P, 3) local.
    points_*: (n, 2) in [0, 1). rows, columns, edges, light: tables of the light's distribution: cumulated over rows, cumulated within
    each row, cosines of the rows' edges, density per texel.
    """
    n_c, n_g, n_e = len(points_c), len(points_g), len(points_e)
    count = n_c + n_g + n_e
    height = len(rows)
    width = len(columns) // height
    for p in range(begin, end):
        tx, ty, tz = float(frame[p, 0, 0]), float(frame[p, 1, 0]), float(frame[p, 2, 0])
        bx, by, bz = float(frame[p, 0, 1]), float(frame[p, 1, 1]), float(frame[p, 2, 1])
        nx, ny, nz = float(frame[p, 0, 2]), float(frame[p, 1, 2]), float(frame[p, 2, 2])
        vx, vy, vz = float(view[p, 0]), float(view[p, 1]), float(view[p, 2])
        a = float(alpha[p])
        a2 = a * a
        masked = 0.5 / (vz + math.sqrt(a2 + (1 - a2) * vz * vz))
        for i in range(first, count):
            if i < n_c + n_g:
                if i < n_c:
                    u0, u1 = _wrapped(points_c[i, 0], shift[p, 0]), _wrapped(points_c[i, 1], shift[p, 1])
                    r, phi = math.sqrt(u0), TURN * u1
                    lx, ly, lz = r * math.cos(np.float32(phi)), r * math.sin(np.float32(phi)), math.sqrt(max(1 - u0, 0.0))
                else:
                    u0, u1 = _wrapped(points_g[i - n_c, 0], shift[p, 0]), _wrapped(points_g[i - n_c, 1], shift[p, 1])
                    lx, ly, lz = _sample_visible_normal(vx, vy, vz, a, u0, u1)
                x, y, z = lx * tx + ly * bx + lz * nx, lx * ty + ly * by + lz * ny, lx * tz + ly * bz + lz * nz
                texel = 0
                if n_e > 0:
                    u, v = lightmap_place(x, y, z)
                    texel = texel_at(u, v, height, width)
            else:
                j = i - n_c - n_g
                u0, u1 = _wrapped(points_e[j, 0], shift[p, 0]), _wrapped(points_e[j, 1], shift[p, 1])
                x, y, z, texel = _sample_light(u0, u1, rows, columns, edges)
                lx, ly, lz = x * tx + y * ty + z * tz, x * bx + y * by + z * bz, x * nx + y * ny + z * nz
            q = n_e * float(light[texel]) + n_c / math.pi * max(lz, 0.0)
            hx, hy, hz = vx + lx, vy + ly, vz + lz
            if hz > 0:
                flat2 = hx * hx + hy * hy
                k = a2 + flat2 / max(flat2 + hz * hz, 1e-14) * (1 - a2)
                q += n_g * masked * a2 / (math.pi * k * k)
            to = i - first
            direction[p, to, 0], direction[p, to, 1], direction[p, to, 2] = x, y, z
            density[p, to] = q / count
