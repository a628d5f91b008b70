# SPDX-License-Identifier: GPL-3.0-or-later
"""Sums of light over secondary rays and light samples, on the GPU.

Definitions: core/kernels/cpu/gathering.py (called by core/relight/indirect_light.py) and core/kernels/cpu/light_samples.py (called by
core/relight/direct_light.py). Every light sample is traced: on a GPU the visibility cache costs more than the rays it saves.
"""

import math
from typing import Any

import torch
import warp as wp

from ..constants import LEAST_ALPHA
from .map_places import place_of
from .reflection import Point, irgs_lobe, lobe, point_of
from .runtime import launch

_PI, _TURN, _LEAST_ALPHA = wp.constant(math.pi), wp.constant(2 * math.pi), wp.constant(LEAST_ALPHA)
Sums = wp.types.vector(length=12, dtype=wp.float32)


@wp.func
def point_at(view: wp.array(dtype=wp.vec3), normal: wp.array(dtype=wp.vec3), alpha: wp.array(dtype=float), p: int) -> Point:
    """Return shading point p; its alpha is that of the samples, which has a lower bound."""
    return point_of(normal[p], view[p], wp.dot(normal[p], view[p]), wp.max(alpha[p], _LEAST_ALPHA))


@wp.func
def turned(u: float, turn: float) -> float:
    """Return u in a map rotated by `turn`, a fraction of a full turn."""
    shifted = u + turn
    return wp.where(shifted >= 1.0, shifted - 1.0, shifted)


@wp.func
def bilinear(maps: wp.array3d(dtype=wp.vec3), level: int, u: float, v: float) -> wp.vec3:
    """Look map `level` of maps (L, H, W) up, bilinearly, wrapped in u."""
    height, width = maps.shape[1], maps.shape[2]
    x, y = u * float(width) - 0.5, wp.clamp(v * float(height) - 0.5, 0.0, float(height) - 1.0)
    x0, top = int(wp.floor(x)), int(wp.floor(y))
    fx, fy = x - float(x0), y - float(top)
    left = wp.where(x0 < 0, x0 + width, wp.min(x0, width - 1))
    right = wp.where(left + 1 < width, left + 1, 0)
    bottom = wp.min(top + 1, height - 1)
    upper = maps[level, top, left] * (1.0 - fx) + maps[level, top, right] * fx
    lower = maps[level, bottom, left] * (1.0 - fx) + maps[level, bottom, right] * fx
    return upper * (1.0 - fy) + lower * fy


@wp.func
def reflected(
    k: int, body: wp.array(dtype=wp.vec3), gloss: wp.array(dtype=wp.vec3), place: wp.array2d(dtype=float), corner: wp.array2d(dtype=int),
    weight: wp.array2d(dtype=float), vertices: wp.array(dtype=wp.vec4), diffuse: wp.array3d(dtype=wp.vec3),
    specular: wp.array3d(dtype=wp.vec3), turn: float,
) -> wp.vec3:  # fmt: skip
    """Return the radiance that hit k reflects along its ray."""
    diffuse_light, visible = wp.vec3(), float(1.0)
    if vertices.shape[0] == 0:
        diffuse_light = bilinear(diffuse, 0, turned(place[k, 0], turn), place[k, 1])
    else:
        at_hit = vertices[corner[k, 0]] * weight[k, 0] + vertices[corner[k, 1]] * weight[k, 1] + vertices[corner[k, 2]] * weight[k, 2]
        diffuse_light, visible = wp.vec3(at_hit[0], at_hit[1], at_hit[2]), at_hit[3]
    u, v, level = turned(place[k, 2], turn), place[k, 3], place[k, 4]
    low = wp.min(int(level), specular.shape[0] - 2)
    fraction = level - float(low)
    specular_light = bilinear(specular, low, u, v) * (1.0 - fraction) + bilinear(specular, low + 1, u, v) * fraction
    return wp.cw_mul(body[k], diffuse_light) + wp.cw_mul(gloss[k], specular_light) * visible


@wp.func
def lit(sums: Sums, weight: float, value: float, bias: float, light: wp.vec3, free: wp.vec3) -> Sums:
    """Return the sums plus one sample: arriving light for each lobe, and the light without occlusion for the diffuse lobe."""
    out = sums
    for channel in range(3):
        out[channel] += weight * light[channel]
        out[3 + channel] += value * light[channel]
        out[6 + channel] += bias * light[channel]
        out[9 + channel] += weight * free[channel]
    return out


@wp.kernel
def terms_kernel(
    view: wp.array(dtype=wp.vec3), normal: wp.array(dtype=wp.vec3), alpha: wp.array(dtype=float), direction: wp.array2d(dtype=wp.vec3),
    density: wp.array2d(dtype=float), irgs: bool, out: wp.array3d(dtype=float),
):  # fmt: skip
    """Write the terms (P, M, 6) of each ray: u, v, cosine, cosine times the lobe's two parts, density; 0 below the horizon."""
    p, i = wp.tid()
    point, d = point_at(view, normal, alpha, p), direction[p, i]
    n_l = wp.dot(point.n, d)
    for c in range(6):
        out[p, i, c] = 0.0
    if n_l > 0.0:
        parts, place = lobe(point, d, n_l), place_of(d)
        if irgs:
            parts = irgs_lobe(point, d, n_l, alpha[p])
        out[p, i, 0] = place[0]
        out[p, i, 1] = place[1]
        out[p, i, 2] = n_l
        out[p, i, 3] = parts[0] * n_l
        out[p, i, 4] = parts[1] * n_l
        out[p, i, 5] = density[p, i]


@wp.kernel
def gather_kernel(
    terms: wp.array3d(dtype=float), row: wp.array2d(dtype=int), opacity: wp.array(dtype=float), body: wp.array(dtype=wp.vec3),
    gloss: wp.array(dtype=wp.vec3), place: wp.array2d(dtype=float), corner: wp.array2d(dtype=int), weight: wp.array2d(dtype=float),
    vertices: wp.array(dtype=wp.vec4), light: wp.array3d(dtype=wp.vec3), diffuse: wp.array3d(dtype=wp.vec3),
    specular: wp.array3d(dtype=wp.vec3), texels: wp.array(dtype=float), light_count: float, turn: float, sums: wp.array3d(dtype=float),
):  # fmt: skip
    """Sum over half of the samples of a point, even or odd ones, to sums (P, 2, 12): see `gather_range` of the CPU."""
    p, half = wp.tid()
    height, width = light.shape[1], light.shape[2]
    acc = Sums(0.0)
    i = int(half)
    while i < terms.shape[1]:
        n_l = terms[p, i, 2]
        if n_l > 0.0:
            u, v = turned(terms[p, i, 0], turn), terms[p, i, 1]
            column, line = wp.clamp(int(u * float(width)), 0, width - 1), wp.clamp(int(v * float(height)), 0, height - 1)
            free = bilinear(light, 0, u, v) / (terms[p, i, 5] + light_count * texels[line * width + column])
            arriving = free
            k = row[p, i]
            if k >= 0:
                surface = reflected(k, body, gloss, place, corner, weight, vertices, diffuse, specular, turn)
                arriving = free + (surface / terms[p, i, 5] - free) * opacity[k]
            acc = lit(acc, n_l, terms[p, i, 3], terms[p, i, 4], arriving, free)
        i += 2
    for c in range(12):
        sums[p, half, c] = sums[p, half, c] + acc[c]


@wp.kernel
def draw_light_kernel(
    view: wp.array(dtype=wp.vec3), normal: wp.array(dtype=wp.vec3), alpha: wp.array(dtype=float), shift: wp.array2d(dtype=float),
    points: wp.array2d(dtype=float), n_c: int, n_g: int, table: wp.array3d(dtype=float), turn: float, irgs: bool,
    entry: wp.array2d(dtype=int), direction: wp.array2d(dtype=wp.vec3), weights: wp.array2d(dtype=wp.vec3),
):  # fmt: skip
    """Draw light samples: entry of the table (P, n_e), -1 below the horizon, direction and weights of the three lobes (P, n_e)."""
    p, i = wp.tid()
    size = table.shape[0]
    across, down = points[i, 0] + shift[p, 0], points[i, 1] + shift[p, 1]
    line = wp.min(int(wp.where(down >= 1.0, down - 1.0, down) * float(size)), size - 1)
    column = wp.min(int(wp.where(across >= 1.0, across - 1.0, across) * float(size)), size - 1)
    cosine, sine = wp.cos(_TURN * turn), wp.sin(_TURN * turn)
    x, y = table[line, column, 0], table[line, column, 1]
    d = wp.vec3(cosine * x - sine * y, sine * x + cosine * y, table[line, column, 2])
    point = point_at(view, normal, alpha, p)
    n_l = wp.dot(point.n, d)
    entry[p, i] = -1
    direction[p, i] = d
    if n_l > 0.0:
        parts = lobe(point, d, n_l)
        sum_l = n_l * point.root + point.n_v * wp.sqrt(n_l * n_l * (1.0 - point.a2) + point.a2)
        masked = 0.5 / (point.n_v + point.root)
        q = float(points.shape[0]) * table[line, column, 3] + float(n_c) / _PI * n_l
        q += float(n_g) * masked * (parts[0] + parts[1]) * 2.0 * sum_l
        if irgs:
            parts = irgs_lobe(point, d, n_l, alpha[p])
        weight = n_l / q
        entry[p, i] = line * size + column
        weights[p, i] = wp.vec3(weight, parts[0] * weight, parts[1] * weight)


@wp.kernel
def settle_kernel(
    entry: wp.array2d(dtype=int), weights: wp.array2d(dtype=wp.vec3), hidden: wp.array2d(dtype=float), table: wp.array3d(dtype=float),
    sums: wp.array3d(dtype=float),
):  # fmt: skip
    """Add half of the light samples of a point, even or odd ones, to its sums (P, 2, 12)."""
    p, half = wp.tid()
    size = table.shape[0]
    acc = Sums(0.0)
    i = int(half)
    while i < entry.shape[1]:
        at = entry[p, i]
        if at >= 0:
            line, column = at / size, at % size
            free = wp.vec3(table[line, column, 4], table[line, column, 5], table[line, column, 6])
            w = weights[p, i]
            acc = lit(acc, w[0], w[1], w[2], free * (1.0 - hidden[p, i]), free)
        i += 2
    for c in range(12):
        sums[p, half, c] = sums[p, half, c] + acc[c]


def terms(*arguments: Any) -> None:
    """Fill the terms of rays that do not depend on the light.

    Args:
        *arguments: as `terms_kernel` takes them; the last, (P, M, 6), is written.
    """
    if arguments[-1].numel():
        launch(terms_kernel, arguments[-1].shape[:2], *arguments)


def gather(*arguments: Any) -> None:
    """Add the light along rays to sums.

    Args:
        *arguments: as `gather_kernel` takes them; the last, (P, 2, 12), is added to.
    """
    if len(arguments[-1]):
        launch(gather_kernel, arguments[-1].shape[:2], *arguments)


def draw_light(
    view: torch.Tensor, normal: torch.Tensor, alpha: torch.Tensor, shift: torch.Tensor, points: torch.Tensor, n_c: int, n_g: int,
    table: torch.Tensor, turn: float, irgs: bool,
) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:  # fmt: skip
    """Draw light samples at points.

    Args:
        view: (P, 3) unit, on the normal's side.
        normal: (P, 3) unit.
        alpha: (P,) GGX width; for IRGS without a lower bound.
        shift: (P, 2) shifts in [0, 1).
        points: (n_e, 2) point set in [0, 1).
        n_c: number of cosine samples in the balance heuristic.
        n_g: number of visible-normal samples in it.
        table: (T, T, 7) direction, density and radiance of the light.
        turn: rotation of the light, fraction of a full turn.
        irgs: the lobe is that of IRGS' BRDF.

    Returns:
        Entry of the table (P, n_e) int32, -1 below the horizon; direction and weights (P, n_e, 3).
    """
    shape = (len(view), len(points))
    entry, direction = torch.empty(shape, dtype=torch.int32, device=view.device), view.new_empty(*shape, 3)
    weights = torch.empty_like(direction)
    if entry.numel():
        launch(draw_light_kernel, shape, view, normal, alpha, shift, points, n_c, n_g, table, turn, irgs, entry, direction, weights)
    return entry, direction, weights


def settle(*arguments: Any) -> None:
    """Add traced light samples to sums.

    Args:
        *arguments: as `settle_kernel` takes them; the last, (P, 2, 12), is added to.
    """
    if len(arguments[-1]):
        launch(settle_kernel, arguments[-1].shape[:2], *arguments)
