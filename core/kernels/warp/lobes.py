# SPDX-License-Identifier: GPL-3.0-or-later
"""Specular lobe over the texels of a light, on the GPU; definitions are in core/kernels/lobes.py."""

import torch
import warp as wp

from ..constants import NARROW
from ..constants import PER_STRATUM as _PER_STRATUM
from .reflection import Point, lobe, point_of, spread
from .runtime import launch

_NARROW, PER_STRATUM = wp.constant(NARROW), wp.constant(_PER_STRATUM)


@wp.func
def direction_at(direction: wp.array2d(dtype=float), at: int) -> wp.vec3:
    """Return direction `at` of (3, D) directions."""
    return wp.vec3(direction[0, at], direction[1, at], direction[2, at])


@wp.func
def parts_of(point: Point, d: wp.vec3, n_l: float, angle: float, strata: wp.array3d(dtype=float), at: int) -> wp.vec2:
    """Return both parts of the lobe times n.l in direction `at`, d, with n_l > 0, or their means within it where the lobe is narrow."""
    if spread(point, d, n_l) >= _NARROW * angle:
        return lobe(point, d, n_l) * n_l
    total = wp.vec2(0.0, 0.0)
    for i in range(PER_STRATUM):
        inner = wp.vec3(strata[at, 0, i], strata[at, 1, i], strata[at, 2, i])
        cosine = wp.dot(point.n, inner)
        if cosine > 0.0:
            total += lobe(point, inner, cosine) * cosine
    return total / float(PER_STRATUM)


@wp.kernel
def rows(
    texels: int, subs: int, point: wp.array(dtype=wp.int64), view: wp.array(dtype=wp.vec3), normal: wp.array(dtype=wp.vec3),
    alpha: wp.array(dtype=float), direction: wp.array2d(dtype=float), solid_angle: wp.array(dtype=float), visible: wp.array2d(dtype=float),
    strata: wp.array3d(dtype=float), f0_term: wp.array2d(dtype=float), fresnel_term: wp.array2d(dtype=float),
):  # fmt: skip
    """Compute both parts of the lobe per texel of the light, (K, texels)."""
    k, texel = wp.tid()
    p = int(point[k])
    n, v = normal[p], view[k]
    shading_point = point_of(n, v, wp.max(wp.dot(n, v), 1.0e-3), alpha[p])
    total = wp.vec2(0.0, 0.0)
    for sub in range(subs):
        at = sub * texels + texel
        d = direction_at(direction, at)
        n_l = wp.dot(n, d)
        if n_l > 0.0:
            total += parts_of(shading_point, d, n_l, solid_angle[at], strata, at) * (solid_angle[at] * visible[p, at])
    f0_term[k, texel] = total[0]
    fresnel_term[k, texel] = total[1]


@wp.kernel
def sums(
    texels: int, count: int, point: wp.array(dtype=wp.int64), view: wp.array(dtype=wp.vec3), normal: wp.array(dtype=wp.vec3),
    alpha: wp.array(dtype=float), each: int, direction: wp.array2d(dtype=float), solid_angle: wp.array(dtype=float),
    visible: wp.array2d(dtype=float), indirect: wp.array3d(dtype=float), strata: wp.array3d(dtype=float), light: wp.array(dtype=wp.vec3),
    f0_term: wp.array2d(dtype=wp.vec3), fresnel_term: wp.array2d(dtype=wp.vec3),
):  # fmt: skip
    """Integrate both parts of the lobe over a light and the indirect light, (K, J); alpha is per point if `each` is 1, else J widths."""
    k, j = wp.tid()
    p = int(point[k])
    n, v = normal[p], view[k]
    width = alpha[j]
    if each == 1:
        width = alpha[p]
    shading_point = point_of(n, v, wp.max(wp.dot(n, v), 1.0e-3), width)
    by_f0, by_fresnel = wp.vec3(0.0, 0.0, 0.0), wp.vec3(0.0, 0.0, 0.0)
    for at in range(count):
        d = direction_at(direction, at)
        n_l = wp.dot(n, d)
        if n_l > 0.0:
            reflected = wp.vec3(indirect[p, 0, at], indirect[p, 1, at], indirect[p, 2, at])
            incoming = (light[at % texels] * visible[p, at] + reflected) * solid_angle[at]
            parts = parts_of(shading_point, d, n_l, solid_angle[at], strata, at)
            by_f0 += incoming * parts[0]
            by_fresnel += incoming * parts[1]
    f0_term[k, j] = by_f0
    fresnel_term[k, j] = by_fresnel


def lobe_sums(
    point: torch.Tensor, view: torch.Tensor, normal: torch.Tensor, alphas: torch.Tensor, traced: tuple[torch.Tensor, ...],
    strata: torch.Tensor, light: torch.Tensor, each: bool = False,
) -> tuple[torch.Tensor, torch.Tensor]:  # fmt: skip
    """Integrate both parts of the lobe over a light and the indirect light, see core/kernels/lobes.py.

    Args:
        point: (K,) int64 point of each view.
        view: (K, 3) unit, towards the eye.
        normal: (P, 3) unit.
        alphas: (J,) GGX widths, or (P,) where `each`.
        traced: as `TracedDirections`: directions (3, D), solid angles (D,), visibility (P, D), indirect radiance (P, 3, D).
        strata: (D, 3, PER_STRATUM) unit directions.
        light: (texels, 3) linear radiance.
        each: use each point's own width; J is 1.

    Returns:
        The part that F0 scales and the part that Fresnel adds, (K, J, 3) each.
    """
    f0_term, fresnel_term = view.new_zeros(2, len(point), 1 if each else len(alphas), 3)
    views = (point, view.contiguous(), normal.contiguous(), alphas.contiguous())
    counts = (len(light), traced[0].shape[1])
    if len(point):
        launch(sums, f0_term.shape[:2], *counts, *views, int(each), *traced, strata, light.contiguous(), f0_term, fresnel_term)
    return f0_term, fresnel_term


def lobe_rows(
    point: torch.Tensor, view: torch.Tensor, normal: torch.Tensor, alpha: torch.Tensor, traced: tuple[torch.Tensor, ...],
    strata: torch.Tensor, texels: int,
) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor, torch.Tensor]:  # fmt: skip
    """Compute the weight of every texel of the light in K views of points, see core/kernels/lobes.py.

    Args:
        point: (K,) int64 point of each view.
        view: (K, 3) unit, towards the eye.
        normal: (P, 3) unit.
        alpha: (P,) GGX widths.
        traced: as `TracedDirections`: directions (3, D), solid angles (D,), visibility (P, D), indirect radiance (P, 3, D).
        strata: (D, 3, PER_STRATUM) unit directions.
        texels: number of texels of the light.

    Returns:
        Both parts, (K, texels) each, and both applied to the indirect light, (K, 3) each.
    """
    direction, angle, visible, _ = traced
    f0_term, fresnel_term = view.new_zeros(2, len(point), texels)
    subs = direction.shape[1] // texels
    views = (point, view.contiguous(), normal.contiguous(), alpha.contiguous())
    if len(point):
        launch(rows, f0_term.shape, texels, subs, *views, direction, angle, visible, strata, f0_term, fresnel_term)
    dark = view.new_zeros(texels, 3)
    f0_indirect, fresnel_indirect = lobe_sums(point, view, normal, alpha, traced, strata, dark, each=True)
    return f0_term, fresnel_term, f0_indirect[:, 0], fresnel_indirect[:, 0]
