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
from .simd import load, ramp, select, splat, store

_ZERO, _HALF, _ONE, _TWO, _THREE = (np.float32(value) for value in (0.0, 0.5, 1.0, 2.0, 3.0))


@helper
def _triple(red, green, blue):
    """Return a vector that begins with three values, and is 0 behind them."""
    lane = ramp()
    return select(lane < _ONE, splat(red), select(lane < _TWO, splat(green), select(lane < _THREE, splat(blue), splat(_ZERO))))


@helper
def _texel(texels, at):
    """Return the texel whose first value is texels[at] as a vector, see `_triple`."""
    return _triple(texels[at], texels[at + 1], texels[at + 2])


@helper
def _bilinear(texels, level, height, width, u, v):
    """Look three channels up in map `level` of flat float32 maps (L H W 3), bilinearly, wrapped in u.

    Return a vector whose lanes c and 3 + c sum to channel c, of a texel and its right neighbour; the last two lanes mean nothing.
    """
    x, y = u * np.float32(width) - _HALF, min(max(v * np.float32(height) - _HALF, _ZERO), np.float32(height - 1))
    x0, top = math.floor(x), int(y)
    fx, fy = x - np.float32(x0), y - np.float32(top)
    left = x0 + width if x0 < 0 else x0
    row, below = (level * height + top) * width, (level * height + min(top + 1, height - 1)) * width
    if left + 1 >= width or (below + left) * 3 + 8 > len(texels):  # the neighbour is at the row's other end, or the maps end too soon
        right = left + 1 if left + 1 < width else 0
        first = _texel(texels, (row + left) * 3) * (_ONE - fx) + _texel(texels, (row + right) * 3) * fx
        second = _texel(texels, (below + left) * 3) * (_ONE - fx) + _texel(texels, (below + right) * 3) * fx
        return first * (_ONE - fy) + second * fy
    across = select(ramp() < _THREE, splat(_ONE - fx), splat(fx))
    return across * (load(texels, (row + left) * 3) * (_ONE - fy) + load(texels, (below + left) * 3) * fy)


@helper
def _channels(pair, lanes):
    """Return the three channels of a vector from `_bilinear`; `lanes` (8,) is overwritten."""
    store(lanes, 0, pair)
    return lanes[0] + lanes[3], lanes[1] + lanes[4], lanes[2] + lanes[5]


@kernel
def reflected_range(begin, end, body, gloss, place, corner, weight, vertices, diffuse, specular, turn, out):
    """Write to `out` (K, 3), for hits begin..end, the radiance that they reflect: diffuse and specular albedo times the light that arrives.

    place: (K, 5) u, v of the normal, u, v of the mirrored ray, level in the specular stack. vertices: (V, 4) irradiance / pi and visible
    fraction of the light at the mesh's vertices, of which `corner` (K, 3) are around the hit with `weight` (K, 3); V = 0: the unoccluded
    light reaches every hit. diffuse: (h, w, 3); specular: (L, h, w, 3).
    """
    levels, height, width = specular.shape[:3]
    texels, smoothest = specular.reshape(-1), diffuse.reshape(-1)
    lanes = np.zeros(8, np.float32)
    for k in range(begin, end):
        visible = _ONE
        if len(vertices) == 0:
            at = _bilinear(smoothest, 0, diffuse.shape[0], diffuse.shape[1], np.float32(turned(place[k, 0], turn)), place[k, 1])
            red, green, blue = _channels(at, lanes)
        else:
            red, green, blue, visible = _ZERO, _ZERO, _ZERO, _ZERO
            for c in range(3):
                at, share = corner[k, c], weight[k, c]
                red += share * vertices[at, 0]
                green += share * vertices[at, 1]
                blue += share * vertices[at, 2]
                visible += share * vertices[at, 3]
        u, v, level = np.float32(turned(place[k, 2], turn)), place[k, 3], place[k, 4]
        low = min(int(level), levels - 2)
        smooth, rough = _bilinear(texels, low, height, width, u, v), _bilinear(texels, low + 1, height, width, u, v)
        r, g, b = _channels((smooth + (rough - smooth) * (level - np.float32(low))) * visible, lanes)
        out[k, 0] = body[k, 0] * red + gloss[k, 0] * r
        out[k, 1] = body[k, 1] * green + gloss[k, 1] * g
        out[k, 2] = body[k, 2] * blue + gloss[k, 2] * b


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
def gather_range(begin, end, terms, row, opacity, reflected, light, texels, light_count, turn, sums):
    """Add to `sums` (P, 2, 12), for points begin..end, the light along rays: even samples to the first half, odd ones to the second.

    The twelve sums, three channels each: light for the diffuse lobe, for F0, for what Fresnel adds, and for the diffuse lobe without any
    occlusion. light: (H, W, 3). `light_count` times the light's own density, `texels` (H W,), is added to the density of the rays where
    they see the light itself, but not for what a hit surface reflects: light samples bring none of that. row: (P, M) index of one of K
    hits, -1 for none; opacity, reflected: (K,) and (K, 3) of them.
    """
    height, width = light.shape[:2]
    light, lanes = light.reshape(-1), np.zeros(32, np.float32)
    for p in range(begin, end):
        for half in range(2):
            whole, by_cosine, by_value, by_bias = splat(_ZERO), splat(_ZERO), splat(_ZERO), splat(_ZERO)
            for i in range(half, terms.shape[1], 2):
                n_l, own = terms[p, i, 2], terms[p, i, 5]
                if n_l <= _ZERO:
                    continue
                u, v = np.float32(turned(terms[p, i, 0], turn)), terms[p, i, 1]
                density = own + light_count * texels[texel_at(u, v, height, width)] if light_count > _ZERO else own
                arriving = _bilinear(light, 0, height, width, u, v) * (_ONE / density)
                whole = whole + arriving * n_l
                k = row[p, i]
                if k >= 0:
                    surface = _triple(reflected[k, 0], reflected[k, 1], reflected[k, 2]) * (_ONE / own)
                    arriving = arriving + (surface - arriving) * opacity[k]
                by_cosine = by_cosine + arriving * n_l
                by_value = by_value + arriving * terms[p, i, 3]
                by_bias = by_bias + arriving * terms[p, i, 4]
            store(lanes, 0, by_cosine)
            store(lanes, 8, by_value)
            store(lanes, 16, by_bias)
            store(lanes, 24, whole)
            for c in range(12):
                at = c // 3 * 8 + c % 3
                sums[p, half, c] += lanes[at] + lanes[at + 3]
