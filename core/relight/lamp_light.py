# SPDX-License-Identifier: GPL-3.0-or-later
"""Light of lamps at surface points, with traced shadows: directly, and reflected once by the surfaces that secondary rays meet.

Directions towards a lamp and GGX visible-normal samples that meet it form one mixture, weighted by the balance heuristic (Veach 1997), so
that both a small lamp on a matt surface and a large one in a mirror converge.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence

import torch

from ..kernels.reflection import weighted_sums
from ..machine.backend import by_warp
from ..scene.lamps import Lamp
from ..shading.brdf import LEAST_ALPHA, sample_visible_normal, visible_normal_density
from ..shading.lamp_sampling import LampLight, draw_lamp, has_extent, seen_lamp
from ..shading.rendering_equation import irgs_sums, weighted_sums_reference
from ..shading.sampling import DENSITY_FLOOR, orthonormal_basis, shifted_points
from .indirect_light import DENSITY, LOBES, TERMS, SecondaryRays, ShadingPoints
from .sample_counts import R2, SampleCounts
from .secondary_query import SurfaceQuery

FULL_LAMPS = 2  # so many lamps get the samples of the light map each; more lamps share them
MIN_LAMP_SAMPLES = 4  # samples of a lamp with extent, per point
BOUNCE_SAMPLES = 2  # samples of a lamp with extent, per point of a surface that a secondary ray meets
MIN_BOUNCE_ALPHA = 0.25  # least GGX alpha of these surfaces: lamps mirrored by mirrors would be bright dots (as Cycles' Filter Glossy)
SHADOW_RAY_FRACTION = 1 - 1e-4  # fraction of the way to a lamp on which occluders count


def samples_per_lamp(counts: SampleCounts, lamps: int) -> int:
    """Return the samples per point and lamp, an even number.

    Args:
        counts: samples of each strategy per point; those of the light map are divided among the lamps.
        lamps: number of lamps.
    """
    return max(MIN_LAMP_SAMPLES, counts.light * FULL_LAMPS // max(FULL_LAMPS, lamps) // 2 * 2)


def lamp_sums(points: ShadingPoints, lamps: Sequence[Lamp], shift: torch.Tensor, count: int, query: SurfaceQuery) -> torch.Tensor:
    """Sum the direct light of lamps, weighted as in the rendering equation.

    Args:
        points: the P points.
        lamps: the lamps, in the frame of the points.
        shift: (P, 2) shift of each point's samples on the torus, in [0, 1).
        count: samples per point and lamp with extent, even.
        query: scene for shadow rays.

    Returns:
        (P, 2, 3, 3) sums over even and over odd samples: light for the diffuse lobe, for F0 and for what Fresnel adds; the last axis is
        colour.
    """
    sums = points.normal.new_zeros(len(points.normal), 2, 3, 3)
    frame = orthonormal_basis(points.normal)
    for lamp in lamps:
        arriving, visible = _samples(points, frame, lamp, shift, count)
        radiance = arriving.radiance * _unoccluded(points, lamp, arriving, visible, query)[..., None]
        for half in (0, 1):
            chosen = slice(half, None, 2) if arriving.density.shape[1] > 1 else slice(None)
            parts = (t[:, chosen].contiguous() for t in (arriving.direction, arriving.density, radiance))
            sums[:, half] += 0.5 * _weighted(points, *parts)
    return sums


def bounced_sums(rays: SecondaryRays, lamps: Sequence[Lamp], query: SurfaceQuery) -> torch.Tensor:
    """Sum the light of lamps that the hit surfaces of secondary rays reflect.

    Args:
        rays: M traced rays of each of P points, with their surfaces.
        lamps: the lamps.
        query: scene for shadow rays.

    Returns:
        (P, 2, 3, 3) sums, see `lamp_sums`.
    """
    surfaces = rays.surfaces
    assert surfaces is not None
    points = dataclasses.replace(surfaces.points, alpha=surfaces.points.alpha.clamp_min(MIN_BOUNCE_ALPHA))
    shift = _shifts(len(points.normal)).to(points.normal)
    irradiance, f0_term, fresnel_term = lamp_sums(points, lamps, shift, BOUNCE_SAMPLES, query).sum(1).unbind(1)
    light = rays.hits.diffuse / math.pi * irradiance + surfaces.f0 * f0_term + fresnel_term
    count = rays.row.shape[1]
    hit = torch.nonzero(rays.row.flatten() >= 0)[:, 0]
    k, terms = rays.row.flatten()[hit].long(), rays.terms.view(-1, TERMS)[hit]
    weight = terms[:, LOBES] / terms[:, DENSITY] * rays.hits.opacity[k, None]
    sums = light.new_zeros(len(rays.row) * 2, 3, 3)
    sums.index_add_(0, hit // count * 2 + hit % count % 2, weight[:, :, None] * light[k, None])
    return sums.view(-1, 2, 3, 3)


def _shifts(count: int) -> torch.Tensor:
    """Return different shifts on the torus, (count, 2) float64, evenly spread (Roberts 2018)."""
    u = torch.arange(count, dtype=torch.float64)[:, None] * torch.tensor(R2, dtype=torch.float64)
    return (u - u.floor()).clamp_max(1 - 1e-7)


def _samples(points: ShadingPoints, frame: torch.Tensor, lamp: Lamp, shift: torch.Tensor, count: int) -> tuple[LampLight, torch.Tensor]:
    """Draw directions towards a lamp; return its light with the density of the mixture, and which of them may be lit (P, N)."""
    if not has_extent(lamp):
        drawn = draw_lamp(lamp, points.origin, shift[:, None])
        return drawn, _above(points, drawn.direction)
    u = shifted_points(count, shift)
    local_view = (points.view[:, None] @ frame).expand(-1, 1, -1)
    alpha = points.alpha[:, None].clamp_min(LEAST_ALPHA)  # of the samples
    even = count // 4 * 2  # half as many as towards the lamp, but even: even and odd samples make independent halves
    half = sample_visible_normal(local_view, alpha, shifted_points(even, shift))
    mirrored = torch.nn.functional.normalize((2 * (local_view * half).sum(-1, keepdim=True) * half - local_view) @ frame.mT, dim=-1)
    both = (draw_lamp(lamp, points.origin, u), seen_lamp(lamp, points.origin, mirrored))
    direction, distance, density, radiance = (torch.cat([getattr(part, f.name) for part in both], 1) for f in dataclasses.fields(LampLight))
    lit = (density > 0) & _above(points, direction)
    mixture = u.shape[1] * density + half.shape[1] * visible_normal_density(local_view, direction @ frame, alpha)
    mixture = torch.where(lit, mixture / direction.shape[1], 1.0).clamp_min(DENSITY_FLOOR)
    return LampLight(direction, distance, mixture, radiance), lit


def _above(points: ShadingPoints, direction: torch.Tensor) -> torch.Tensor:
    """Return which directions (P, N, 3) lie above the horizon."""
    return torch.einsum("pnc,pc->pn", direction, points.normal) > 0


def _unoccluded(points: ShadingPoints, lamp: Lamp, arriving: LampLight, lit: torch.Tensor, query: SurfaceQuery) -> torch.Tensor:
    """Return the fraction (P, N) of the light that arrives: 0 where not `lit`, else as shadow rays find it."""
    lit = lit & (arriving.radiance.amax(-1) > 0)
    fraction = lit.to(arriving.density)
    if not lamp.shadow:
        return fraction
    point, sample = torch.nonzero(lit, as_tuple=True)
    ways = (arriving.direction[point, sample], SHADOW_RAY_FRACTION * arriving.distance[point, sample])
    fraction[point, sample] = 1 - query.hidden(points.origin[point], ways[0].contiguous(), ways[1].contiguous()).to(fraction)
    return fraction


def _weighted(points: ShadingPoints, direction: torch.Tensor, density: torch.Tensor, radiance: torch.Tensor) -> torch.Tensor:
    """Return means over samples (P, 3, 3), see `weighted_sums`."""
    if points.brdf == "irgs":
        return irgs_sums(points.view, points.normal, points.alpha.sqrt(), direction, density, radiance)
    use_kernel = radiance.dtype == torch.float32 and not by_warp(radiance)
    function = weighted_sums if use_kernel else weighted_sums_reference
    return function(points.view, points.normal, points.alpha, direction, density, radiance)
