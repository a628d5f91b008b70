# SPDX-License-Identifier: GPL-3.0-or-later
"""Sums over traced samples of the light that they find, in one pass: looked up where a ray is free, reflected where it meets something.

The twin in plain operations stands beside the caller, relight/gathering.py.
"""

from __future__ import annotations

import math

import numpy as np

from .directions import lightmap_place, texel_at
from .jit import kernel
from .reflection import specular_terms


@kernel
def _bilinear(maps, level, u, v):
    """Three channels of one of the maps (L, H, W, 3), wrapped in u."""
    height, width = maps.shape[1], maps.shape[2]
    x, y = u * width - 0.5, min(max(v * height - 0.5, 0.0), height - 1.0)
    x0, y0 = math.floor(x), math.floor(y)
    fx, fy = x - x0, y - y0
    left = int(x0) + width if x0 < 0 else int(x0)
    right = left + 1 if left + 1 < width else 0
    top = int(y0)
    bottom = min(top + 1, height - 1)
    a, b, c, d = (1 - fx) * (1 - fy), fx * (1 - fy), (1 - fx) * fy, fx * fy
    red, green, blue = 0.0, 0.0, 0.0
    for row, column, weight in ((top, left, a), (top, right, b), (bottom, left, c), (bottom, right, d)):
        red += weight * maps[level, row, column, 0]
        green += weight * maps[level, row, column, 1]
        blue += weight * maps[level, row, column, 2]
    return red, green, blue


@kernel
def _reflected(k, body, gloss, place, diffuse, specular):
    """What hit k sends along its ray: its lobes times prefiltered light; place: u, v of its normal, of the mirrored ray, level."""
    red, green, blue = _bilinear(diffuse, 0, float(place[k, 0]), float(place[k, 1]))
    u, v, level = float(place[k, 2]), float(place[k, 3]), float(place[k, 4])
    low = min(int(level), specular.shape[0] - 2)
    f = level - low
    r0, g0, b0 = _bilinear(specular, low, u, v)
    r1, g1, b1 = _bilinear(specular, low + 1, u, v)
    red = float(body[k, 0]) * red + float(gloss[k, 0]) * (r0 + f * (r1 - r0))
    green = float(body[k, 1]) * green + float(gloss[k, 1]) * (g0 + f * (g1 - g0))
    blue = float(body[k, 2]) * blue + float(gloss[k, 2]) * (b0 + f * (b1 - b0))
    return red, green, blue


@kernel
def gather_range(
    begin, end, view, normal, alpha, direction, density, row, opacity, body, gloss, place, light, diffuse, specular, texels, share, sums
):
    """Points begin..end: add to `sums` (P, 2, 12), even samples to the first half and odd ones to the second.

    Twelve sums, three channels each: light for the diffuse lobe, for F0, for what Fresnel adds, and for the diffuse lobe were no ray
    hidden. density: (P, M), to which `share` times the light's own, `texels` (H W), comes. row: (P, M) which of K hits, -1 for none.
    """
    count, height, width = direction.shape[1], light.shape[1], light.shape[2]
    acc = np.empty(24)
    for p in range(begin, end):
        acc[:] = 0.0
        nx, ny, nz = float(normal[p, 0]), float(normal[p, 1]), float(normal[p, 2])
        vx, vy, vz = float(view[p, 0]), float(view[p, 1]), float(view[p, 2])
        a2 = float(alpha[p]) * float(alpha[p])
        n_v = nx * vx + ny * vy + nz * vz
        root_v = math.sqrt(n_v * n_v * (1 - a2) + a2)
        for i in range(count):
            dx, dy, dz = float(direction[p, i, 0]), float(direction[p, i, 1]), float(direction[p, i, 2])
            n_l = nx * dx + ny * dy + nz * dz
            if n_l <= 0:
                continue
            u, v = lightmap_place(dx, dy, dz)
            q = float(density[p, i])
            if share > 0:
                q += share * float(texels[texel_at(u, v, height, width)])
            weight = n_l / q
            r, g, b = _bilinear(light, 0, u, v)
            at = (i & 1) * 12
            acc[at + 9] += weight * r
            acc[at + 10] += weight * g
            acc[at + 11] += weight * b
            k = row[p, i]
            if k >= 0:
                hr, hg, hb = _reflected(k, body, gloss, place, diffuse, specular)
                hidden = float(opacity[k])
                r, g, b = r + hidden * (hr - r), g + hidden * (hg - g), b + hidden * (hb - b)
            value, bias = specular_terms(nx, ny, nz, vx, vy, vz, dx, dy, dz, n_l, n_v, root_v, a2)
            value, bias = value * weight, bias * weight
            acc[at] += weight * r
            acc[at + 1] += weight * g
            acc[at + 2] += weight * b
            acc[at + 3] += value * r
            acc[at + 4] += value * g
            acc[at + 5] += value * b
            acc[at + 6] += bias * r
            acc[at + 7] += bias * g
            acc[at + 8] += bias * b
        for c in range(12):
            sums[p, 0, c] += acc[c]
            sums[p, 1, c] += acc[12 + c]
