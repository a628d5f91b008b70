# SPDX-License-Identifier: GPL-3.0-or-later
"""Sums of the light that arrives along traced secondary rays, in one pass; called by core/relight/indirect_light.py.

Free rays look the light up in its map; rays that hit a surface receive what the surface reflects. Terms that do not depend on the light
are computed once (`terms_range`). The reference in PyTorch operations is `tests/support/gather_reference.py`.
"""

from __future__ import annotations

import math

import numpy as np

from .directions import lightmap_place, texel_at, turned
from .jit import helper, kernel
from .reflection import irgs_terms, point_terms, specular_terms


@helper
def _bilinear(maps, level, u, v):
    """Look three channels up in map `level` of maps (L, H, W, 3), bilinearly, wrapped in u.

    Scalar code for kernels; `tests/core/shading/test_lightmap_agreement.py` compares it with the lookups in PyTorch and numpy.
    """
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


@helper
def reflected(k, body, gloss, place, corner, weight, vertices, diffuse, specular, turn):
    """Return the radiance that hit k reflects along its ray: its diffuse and specular albedo times the light that reaches it.

    place: (K, 5) u, v of the normal, u, v of the mirrored ray, level in the specular stack. vertices: (V, 4) irradiance / pi and visible
    fraction of the light at the mesh's vertices, of which `corner` (K, 3) are around the hit with `weight` (K, 3); V = 0: the unoccluded
    light reaches every hit.
    """
    visible = 1.0
    if len(vertices) == 0:
        red, green, blue = _bilinear(diffuse, 0, turned(float(place[k, 0]), turn), float(place[k, 1]))
    else:
        red, green, blue, visible = 0.0, 0.0, 0.0, 0.0
        for c in range(3):
            at, share = corner[k, c], float(weight[k, c])
            red += share * vertices[at, 0]
            green += share * vertices[at, 1]
            blue += share * vertices[at, 2]
            visible += share * vertices[at, 3]
    u, v, level = turned(float(place[k, 2]), turn), float(place[k, 3]), float(place[k, 4])
    low = min(int(level), specular.shape[0] - 2)
    f = level - low
    r0, g0, b0 = _bilinear(specular, low, u, v)
    r1, g1, b1 = _bilinear(specular, low + 1, u, v)
    red = float(body[k, 0]) * red + visible * float(gloss[k, 0]) * (r0 + f * (r1 - r0))
    green = float(body[k, 1]) * green + visible * float(gloss[k, 1]) * (g0 + f * (g1 - g0))
    blue = float(body[k, 2]) * blue + visible * float(gloss[k, 2]) * (b0 + f * (b1 - b0))
    return red, green, blue


@kernel
def terms_range(begin, end, view, normal, alpha, direction, density, irgs, terms):
    """Write to `terms` (P, M, 6), for points begin..end, the terms of each ray that do not depend on the light; 0 below the horizon.

    They are u, v, cosine, cosine times the two parts of the specular lobe, and density. irgs: True for the lobe of IRGS' BRDF.
    """
    for p in range(begin, end):
        (nx, ny, nz), (vx, vy, vz), a2, n_v, root_v = point_terms(view, normal, alpha, p)
        for i in range(direction.shape[1]):
            dx, dy, dz = float(direction[p, i, 0]), float(direction[p, i, 1]), float(direction[p, i, 2])
            n_l = nx * dx + ny * dy + nz * dz
            if n_l <= 0:
                terms[p, i, :] = 0.0
                continue
            if irgs:
                value, bias = irgs_terms(nx, ny, nz, vx, vy, vz, dx, dy, dz, n_l, n_v, a2)
            else:
                value, bias = specular_terms(nx, ny, nz, vx, vy, vz, dx, dy, dz, n_l, n_v, root_v, a2)
            terms[p, i, 0], terms[p, i, 1] = lightmap_place(dx, dy, dz)
            terms[p, i, 2], terms[p, i, 3], terms[p, i, 4] = n_l, value * n_l, bias * n_l
            terms[p, i, 5] = density[p, i]


@kernel
def gather_range(
    begin, end, terms, row, opacity, body, gloss, place, corner, weight, vertices, light, diffuse, specular, texels, light_count, turn, sums
):  # fmt: skip
    """Add to `sums` (P, 2, 12), for points begin..end, the light along rays: even samples to the first half, odd ones to the second.

    The twelve sums, three channels each: light for the diffuse lobe, for F0, for what Fresnel adds, and for the diffuse lobe without any
    occlusion. `light_count` times the light's own density, `texels` (H W,), is added to the density of the rays where they see the light
    itself, but not for what a hit surface reflects: light samples bring none of that. row: (P, M) index of one of K hits, -1 for none.
    """
    height, width = light.shape[1], light.shape[2]
    acc = np.empty(24)
    for p in range(begin, end):
        acc[:] = 0.0
        for i in range(terms.shape[1]):
            n_l = float(terms[p, i, 2])
            if n_l <= 0:
                continue
            u, v = turned(float(terms[p, i, 0]), turn), float(terms[p, i, 1])
            q = float(terms[p, i, 5])
            if light_count > 0:
                q += light_count * float(texels[texel_at(u, v, height, width)])
            r, g, b = _bilinear(light, 0, u, v)
            r, g, b = r / q, g / q, b / q
            at = (i & 1) * 12
            acc[at + 9] += n_l * r
            acc[at + 10] += n_l * g
            acc[at + 11] += n_l * b
            k = row[p, i]
            if k >= 0:
                hr, hg, hb = reflected(k, body, gloss, place, corner, weight, vertices, diffuse, specular, turn)
                hidden, own = float(opacity[k]), 1 / float(terms[p, i, 5])
                r, g, b = r + hidden * (own * hr - r), g + hidden * (own * hg - g), b + hidden * (own * hb - b)
            value, bias = float(terms[p, i, 3]), float(terms[p, i, 4])
            acc[at] += n_l * r
            acc[at + 1] += n_l * g
            acc[at + 2] += n_l * b
            acc[at + 3] += value * r
            acc[at + 4] += value * g
            acc[at + 5] += value * b
            acc[at + 6] += bias * r
            acc[at + 7] += bias * g
            acc[at + 8] += bias * b
        for c in range(12):
            sums[p, 0, c] += acc[c]
            sums[p, 1, c] += acc[12 + c]
