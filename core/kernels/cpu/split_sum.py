# SPDX-License-Identifier: GPL-3.0-or-later
"""CPU kernels of deferred split-sum shading and its gradient; see core/kernels/split_sum.py.

Each pixel is a scalar computation: most of its time goes to the texels it gathers and to two arc tangents, which the forward pass keeps.
"""

from __future__ import annotations

import math

from ..constants import DIELECTRIC_F0
from .directions import lightmap_place
from .jit import helper, kernel

_SHORTEST = 1e-12  # lower bound of a normal's length, as in torch.nn.functional.normalize
_POLE2 = 1e-12  # lower bound of a squared sine: exactly at a pole the azimuth has no gradient
_LEAST_COSINE = 1e-3


@helper
def _turned(rotation, x, y, z):
    """Return rotation (3, 3) times a vector."""
    return (
        rotation[0, 0] * x + rotation[0, 1] * y + rotation[0, 2] * z,
        rotation[1, 0] * x + rotation[1, 1] * y + rotation[1, 2] * z,
        rotation[2, 0] * x + rotation[2, 1] * y + rotation[2, 2] * z,
    )


@helper
def _unit(x, y, z):
    """Return a vector divided by its length, and 1 / length."""
    inverse = 1 / max(math.sqrt(x * x + y * y + z * z), _SHORTEST)
    return x * inverse, y * inverse, z * inverse, inverse


@helper
def _geometry(image, rays, rotation, p, inverse):
    """Return normal, mirrored view direction and view direction of pixel p in the light's frame, n.v and 1 / length of the mean normal."""
    nx, ny, nz, length = _unit(image[3, p] * inverse, image[4, p] * inverse, image[5, p] * inverse)
    vx, vy, vz, _ = _unit(-float(rays[0, p]), -float(rays[1, p]), -float(rays[2, p]))
    n, v = _turned(rotation, nx, ny, nz), _turned(rotation, vx, vy, vz)
    cosine = n[0] * v[0] + n[1] * v[1] + n[2] * v[2]
    mirrored = (2 * cosine * n[0] - v[0], 2 * cosine * n[1] - v[1], 2 * cosine * n[2] - v[2])
    return n, mirrored, v, cosine, length


@helper
def _level(roughness, knots):
    """Return the lower level of the stack for a roughness, the fraction of the way to the next, and its slope."""
    low = 0
    for i in range(1, len(knots) - 1):
        low += roughness > knots[i]
    slope = 1 / (float(knots[low + 1]) - knots[low])
    fraction = (roughness - knots[low]) * slope
    if (low == 0 and fraction <= 0) or (low == len(knots) - 2 and fraction >= 1):
        return low, min(max(fraction, 0.0), 1.0), 0.0
    return low, fraction, slope


@helper
def _corners(x, y, height, width):
    """Return columns, rows and fractions of the four texels around texel coordinates x, which wraps, and y, which is clamped."""
    y = min(max(y, 0.0), height - 1.0)
    column, row = math.floor(x), math.floor(y)
    left = int(column) + width if column < 0 else int(column)
    return left, left + 1 if left + 1 < width else 0, int(row), min(int(row) + 1, height - 1), x - column, y - row


@helper
def _albedo_terms(table, n_v, roughness):
    """Interpolate scale and bias of F0 at n.v and roughness; return both, and their slopes by n.v and by roughness."""
    last = table.shape[0] - 1
    x, y = n_v * last, min(max(roughness, 0.0), 1.0) * last
    i, j = min(int(x), last - 1), min(int(y), last - 1)
    x, y = x - i, y - j
    a0, a1, b0, b1 = float(table[j, i, 0]), float(table[j, i + 1, 0]), float(table[j + 1, i, 0]), float(table[j + 1, i + 1, 0])
    c0, c1, d0, d1 = float(table[j, i, 1]), float(table[j, i + 1, 1]), float(table[j + 1, i, 1]), float(table[j + 1, i + 1, 1])
    a, b, c, d = a0 + x * (a1 - a0), b0 + x * (b1 - b0), c0 + x * (c1 - c0), d0 + x * (d1 - d0)
    by_cosine = last * ((1 - y) * (a1 - a0) + y * (b1 - b0)), last * ((1 - y) * (c1 - c0) + y * (d1 - d0))
    return a + y * (b - a), c + y * (d - c), by_cosine, (last * (b - a), last * (d - c))


@kernel
def shade_range(begin, end, image, rays, rotation, stack, mirrored, knots, table, reflecting, floor, place, out):
    """Write the radiance of pixels begin..end to `out` (3, P), and texel coordinates of what they mirror to `place` (2, P).

    image: (C, P) sums of the rasteriser. rays: (3, P). stack: (L, H, W, 3); without levels no pixel reflects. mirrored: (4, P)
    transmittance along the mirrored direction and radiance of what blocks it; (4, 0): nothing does.
    """
    levels, height, width, _ = stack.shape
    opacity = image.shape[0] - 1
    for p in range(begin, end):
        alpha = float(image[opacity, p])
        if levels == 0 or not alpha > reflecting:
            inverse = 1 / max(alpha, floor)
            for k in range(3):
                out[k, p] = image[k, p] * inverse
            continue
        inverse = 1 / alpha
        _, towards, _, cosine, _ = _geometry(image, rays, rotation, p, inverse)
        u, v = lightmap_place(towards[0], towards[1], towards[2])
        x, y = u * width - 0.5, v * height - 0.5
        place[0, p], place[1, p] = x, y
        roughness, metallic = image[9, p] * inverse, image[10, p] * inverse
        scale, bias, _, _ = _albedo_terms(table, min(max(cosine, _LEAST_COSINE), 1.0), roughness)
        low, fraction, _ = _level(roughness, knots)
        left, right, top, bottom, fx, fy = _corners(x, y, height, width)
        for k in range(3):
            light = 0.0
            for level, share in ((low, 1 - fraction), (low + 1, fraction)):
                above = stack[level, top, left, k] * (1 - fx) + stack[level, top, right, k] * fx
                below = stack[level, bottom, left, k] * (1 - fx) + stack[level, bottom, right, k] * fx
                light += share * (above * (1 - fy) + below * fy)
            if mirrored.shape[1] > 0:
                light = mirrored[0, p] * light + mirrored[1 + k, p]
            f0 = DIELECTRIC_F0 * (1 - metallic) + metallic * image[6 + k, p] * inverse
            out[k, p] = (1 - metallic) * image[k, p] * inverse + light * (f0 * scale + bias)


@helper
def _normal_gradient(n, mirrored, v, cosine, gx, gy, g_cosine):
    """Return the gradient of the unit normal, orthogonal to it, from those of u, v of the mirrored direction and of n.v."""
    x, y, z = mirrored
    sine2 = max(x * x + y * y, _POLE2)
    sine = math.sqrt(sine2)
    around, down = gx / (2 * math.pi * sine2), gy / math.pi
    g = (around * y + down * z * x / sine, down * z * y / sine - around * x, -down * sine)
    along = 2 * (g[0] * n[0] + g[1] * n[1] + g[2] * n[2]) + g_cosine
    a, b, c = 2 * cosine * g[0] + along * v[0], 2 * cosine * g[1] + along * v[1], 2 * cosine * g[2] + along * v[2]
    radial = a * n[0] + b * n[1] + c * n[2]
    return a - radial * n[0], b - radial * n[1], c - radial * n[2]


@kernel
def shade_backward_range(
    slot, begin, end, image, rays, rotation, stack, mirrored, knots, table, reflecting, floor, place, upstream, gradient, slots
):  # fmt: skip
    """Compute the adjoint of `shade_range`: write `gradient` (C, P) and add that of the stack to slots[slot] (L, H, W, 3).

    Without slots the stack's gradient is not computed. `mirrored` is constant.
    """
    levels, height, width, _ = stack.shape
    opacity = image.shape[0] - 1
    for p in range(begin, end):
        for j in range(3, opacity):
            gradient[j, p] = 0.0
        alpha = float(image[opacity, p])
        if levels == 0 or not alpha > reflecting:
            inverse, g_alpha = 1 / max(alpha, floor), 0.0
            for k in range(3):
                gradient[k, p] = upstream[k, p] * inverse
                g_alpha -= upstream[k, p] * image[k, p] * inverse * inverse
            gradient[opacity, p] = g_alpha if alpha > floor else 0.0
            continue
        inverse = 1 / alpha
        n, towards, v, cosine, length = _geometry(image, rays, rotation, p, inverse)
        roughness, metallic = image[9, p] * inverse, image[10, p] * inverse
        scale, bias, by_cosine, by_roughness = _albedo_terms(table, min(max(cosine, _LEAST_COSINE), 1.0), roughness)
        low, f, slope = _level(roughness, knots)
        left, right, top, bottom, fx, fy = _corners(place[0, p], place[1, p], height, width)
        gx, gy, g_level, g_scale, g_bias, g_metallic, g_alpha = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
        passing = float(mirrored[0, p]) if mirrored.shape[1] > 0 else 1.0
        for k in range(3):
            g, colour, albedo = float(upstream[k, p]), image[k, p] * inverse, image[6 + k, p] * inverse
            f0 = DIELECTRIC_F0 * (1 - metallic) + metallic * albedo
            a0, b0, c0, d0 = stack[low, top, left, k], stack[low, top, right, k], stack[low, bottom, left, k], stack[low, bottom, right, k]
            a1, b1 = stack[low + 1, top, left, k], stack[low + 1, top, right, k]
            c1, d1 = stack[low + 1, bottom, left, k], stack[low + 1, bottom, right, k]
            a, b, c, d = a0 + f * (a1 - a0), b0 + f * (b1 - b0), c0 + f * (c1 - c0), d0 + f * (d1 - d0)
            above, below = a + fx * (b - a), c + fx * (d - c)
            light = passing * (above + fy * (below - above))
            if mirrored.shape[1] > 0:
                light += mirrored[1 + k, p]
            g_light, g_term = passing * g * (f0 * scale + bias), g * light
            gx += g_light * ((1 - fy) * (b - a) + fy * (d - c))
            gy += g_light * (below - above)
            g_level += g_light * ((1 - fy) * ((1 - fx) * (a1 - a0) + fx * (b1 - b0)) + fy * ((1 - fx) * (c1 - c0) + fx * (d1 - d0)))
            g_scale += g_term * f0
            g_bias += g_term
            g_f0 = g_term * scale
            g_metallic += g_f0 * (albedo - DIELECTRIC_F0) - g * colour
            g_colour, g_albedo = g * (1 - metallic), g_f0 * metallic
            gradient[k, p], gradient[6 + k, p] = g_colour * inverse, g_albedo * inverse
            g_alpha += g_colour * colour + g_albedo * albedo
            if len(slots) > 0:
                for level, share in ((low, g_light * (1 - f)), (low + 1, g_light * f)):
                    slots[slot, level, top, left, k] += share * (1 - fx) * (1 - fy)
                    slots[slot, level, top, right, k] += share * fx * (1 - fy)
                    slots[slot, level, bottom, left, k] += share * (1 - fx) * fy
                    slots[slot, level, bottom, right, k] += share * fx * fy
        g_roughness = g_level * slope
        if 0 < roughness < 1:
            g_roughness += g_scale * by_roughness[0] + g_bias * by_roughness[1]
        free = _LEAST_COSINE <= cosine <= 1
        g_cosine = g_scale * by_cosine[0] + g_bias * by_cosine[1] if free else 0.0
        inside = 0 < place[1, p] < height - 1
        ga, gb, gc = _normal_gradient(n, towards, v, cosine, gx * width, gy * height if inside else 0.0, g_cosine)
        for j in range(3):  # the rotation is undone by its transpose
            gradient[3 + j, p] = (rotation[0, j] * ga + rotation[1, j] * gb + rotation[2, j] * gc) * length * inverse
        gradient[9, p], gradient[10, p] = g_roughness * inverse, g_metallic * inverse
        gradient[opacity, p] = -(g_alpha + g_roughness * roughness + g_metallic * metallic) * inverse
