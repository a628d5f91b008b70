# SPDX-License-Identifier: GPL-3.0-or-later
"""Sample directions with the density of their mixture on the GPU, a thread per sample; formulas as in core/kernels/cpu/directions.py."""

import math

import torch
import warp as wp

from ..constants import COSINE_FLOOR
from .map_places import place_of
from .runtime import launch

_PI, _TURN, _FLOOR = wp.constant(math.pi), wp.constant(2 * math.pi), wp.constant(COSINE_FLOOR)


@wp.func
def wrapped(point: wp.vec2d, shift: wp.vec2) -> wp.vec2d:
    """Shift a point in [0, 1)^2 by another, on the torus."""
    u, v = point[0] + wp.float64(shift[0]), point[1] + wp.float64(shift[1])
    one = wp.float64(1.0)
    return wp.vec2d(wp.where(u >= one, u - one, u), wp.where(v >= one, v - one, v))


@wp.func
def frame_of(n: wp.vec3) -> wp.mat33:
    """Return tangent, bitangent and normal as columns, see `orthonormal_basis`."""
    sign = wp.where(n[2] < 0.0, -1.0, 1.0)
    a = -1.0 / (sign + n[2])
    b = n[0] * n[1] * a
    tangent = wp.vec3(1.0 + sign * n[0] * n[0] * a, sign * b, -sign * n[0])
    return wp.matrix_from_cols(tangent, wp.vec3(b, sign + n[1] * n[1] * a, -n[1]), n)


@wp.func
def bent(view: wp.vec3, n: wp.vec3) -> wp.vec3:
    """Return a view direction bent towards the normal, see `bend_view_to_normal`."""
    return wp.normalize(view + n * wp.max(_FLOOR - wp.dot(view, n), 0.0))


@wp.func
def first_above(table: wp.array(dtype=wp.float64), value: wp.float64, low: int, high: int) -> int:
    """Return the index of the first entry of ascending table[low:high] greater than `value`, at most `high` - 1."""
    at, size = int(low), int(high - low)
    while size > 1:
        half = size / 2
        if table[at + half - 1] <= value:
            at += half
        size -= half
    return at


@wp.func
def cosine_direction(u: wp.vec2d) -> wp.vec3:
    """Return a local direction of density cos / pi."""
    r, phi = wp.sqrt(float(u[0])), _TURN * float(u[1])
    return wp.vec3(r * wp.cos(phi), r * wp.sin(phi), wp.sqrt(wp.max(1.0 - float(u[0]), 0.0)))


@wp.func
def mirrored_at_visible_normal(v: wp.vec3, alpha: float, u: wp.vec2d) -> wp.vec3:
    """Return a local view direction mirrored at a sampled visible normal, by spherical caps (Dupuy and Benyoub 2023)."""
    w = wp.normalize(wp.vec3(v[0] * alpha, v[1] * alpha, v[2]))
    z = (1.0 - float(u[0])) * (1.0 + w[2]) - w[2]
    r, phi = wp.sqrt(wp.max(1.0 - z * z, 0.0)), _TURN * float(u[1])
    h = wp.vec3((r * wp.cos(phi) + w[0]) * alpha, (r * wp.sin(phi) + w[1]) * alpha, wp.max(z + w[2], 1.0e-6))
    return h * (2.0 * wp.dot(v, h) / wp.dot(h, h)) - v


@wp.func
def light_direction(
    u: wp.vec2d, rows: wp.array(dtype=wp.float64), columns: wp.array(dtype=wp.float64), edges: wp.array(dtype=wp.float64)
) -> wp.vec3:
    """Return a world direction by the light map's tables."""
    height = rows.shape[0]
    width = columns.shape[0] / height
    zero, one = wp.float64(0.0), wp.float64(1.0)
    row = first_above(rows, u[1], 0, height)
    before = zero
    if row > 0:
        before = rows[row - 1]
    down = wp.clamp((u[1] - before) / (rows[row] - before), zero, one)
    across = u[0] + wp.float64(row)
    flat = first_above(columns, across, row * width, row * width + width)
    left = wp.float64(row)
    if flat > row * width:
        left = columns[flat - 1]
    share = wp.clamp((across - left) / (columns[flat] - left), zero, one)
    phi = float((wp.float64(flat - row * width) + share) / wp.float64(width)) * _TURN
    z = float(edges[row] + (edges[row + 1] - edges[row]) * down)
    s = wp.sqrt(wp.max(1.0 - z * z, 0.0))
    return wp.vec3(-s * wp.cos(phi), s * wp.sin(phi), z)


@wp.func
def light_density(d: wp.vec3, texels: wp.array(dtype=float), height: int) -> float:
    """Return the density of the light's samples in a unit direction, per steradian."""
    width, place = texels.shape[0] / height, place_of(d)
    column, row = wp.clamp(int(place[0] * float(width)), 0, width - 1), wp.clamp(int(place[1] * float(height)), 0, height - 1)
    return texels[row * width + column]


@wp.func
def visible_density(v: wp.vec3, local: wp.vec3, alpha: float) -> float:
    """Return the density per steradian of directions mirrored at visible normals, see `visible_normal_density`."""
    a2, h = alpha * alpha, v + local
    if h[2] <= 0.0:
        return 0.0
    flat2 = h[0] * h[0] + h[1] * h[1]
    k = a2 + flat2 / wp.max(flat2 + h[2] * h[2], 1.0e-14) * (1.0 - a2)
    return 0.5 / (v[2] + wp.sqrt(a2 + (1.0 - a2) * v[2] * v[2])) * a2 / (_PI * k * k)


@wp.kernel
def draw(
    view: wp.array(dtype=wp.vec3), normal: wp.array(dtype=wp.vec3), alpha: wp.array(dtype=float), shift: wp.array(dtype=wp.vec2),
    points_c: wp.array(dtype=wp.vec2d), points_g: wp.array(dtype=wp.vec2d), points_e: wp.array(dtype=wp.vec2d), first: int,
    rows: wp.array(dtype=wp.float64), columns: wp.array(dtype=wp.float64), edges: wp.array(dtype=wp.float64),
    texels: wp.array(dtype=float), least: float, direction: wp.array2d(dtype=wp.vec3), density: wp.array2d(dtype=float),
):  # fmt: skip
    """Draw cosine, visible-normal and light samples, in this order, from number `first` on: `draw_range` of the CPU.

    Writes directions and densities (P, N), these at least `least`.
    """
    p, to = wp.tid()
    i, n_c, n_g, n_e = to + first, points_c.shape[0], points_g.shape[0], points_e.shape[0]
    a, basis = alpha[p], frame_of(normal[p])
    v = wp.transpose(basis) * bent(view[p], normal[p])
    d, local = wp.vec3(0.0, 0.0, 0.0), wp.vec3(0.0, 0.0, 0.0)
    if i < n_c + n_g:
        if i < n_c:
            local = cosine_direction(wrapped(points_c[i], shift[p]))
        else:
            local = mirrored_at_visible_normal(v, a, wrapped(points_g[i - n_c], shift[p]))
        d = basis * local
    else:
        d = light_direction(wrapped(points_e[i - n_c - n_g], shift[p]), rows, columns, edges)
        local = wp.transpose(basis) * d
    q = float(n_c) / _PI * wp.max(local[2], 0.0) + float(n_g) * visible_density(v, local, a)
    if n_e > 0:
        q += float(n_e) * light_density(d, texels, rows.shape[0])
    direction[p, to] = d
    density[p, to] = wp.max(q / float(n_c + n_g + n_e), least)


def draw_mixture(
    view: torch.Tensor, normal: torch.Tensor, alpha: torch.Tensor, shift: torch.Tensor, points: list[torch.Tensor], first: int,
    tables: list[torch.Tensor], least: float,
) -> tuple[torch.Tensor, torch.Tensor]:  # fmt: skip
    """Draw the mixture of samples at P points.

    Args:
        view: (P, 3) unit, towards the eye.
        normal: (P, 3) unit.
        alpha: (P,) GGX width.
        shift: (P, 2) shifts on the torus, in [0, 1).
        points: point sets of the three strategies, (n, 2) float64 each.
        first: number of the first sample to return.
        tables: rows, columns, edges (float64) and texels of `LightDistribution`.
        least: lower bound of the densities.

    Returns:
        Unit directions (P, N, 3) and their density in the mixture, (P, N) per steradian.
    """
    count = sum(map(len, points)) - first
    direction, density = view.new_empty(len(view), count, 3), view.new_empty(len(view), count)
    if density.numel():
        inputs = [t.contiguous() for t in (view, normal, alpha, shift, *points)]
        launch(draw, density.shape, *inputs, first, *(t.contiguous() for t in tables), least, direction, density)
    return direction, density
