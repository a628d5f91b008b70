# SPDX-License-Identifier: GPL-3.0-or-later
"""Where to look for light: cosine, visible-normal and light-map samples under the balance heuristic, or plain strata.

The mixture is deterministic: q = (N_c p_c + N_g p_g + N_e p_e) / N, evaluated at every sample whatever strategy drew it (Veach 1997).
All of it is detached: sampling follows materials and light, gradients flow through what is sampled.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cache

import torch

from ..kernels.cpu.directions import draw_range
from ..machine.backend import by_warp
from ..machine.thread_pool import even_ranges, run_ranges, thread_count
from .brdf import facing, ggx_alpha, sample_visible_normal, visible_normal_density
from .light_distribution import LightDistribution

METHODS = ("mis", "stratified")
DENSITY_FLOOR = 1e-9  # keeps weights finite where a density underflows; far below any that counts


@dataclass(frozen=True, eq=False)
class Samples:
    """N directions at each of P points.

    Attributes:
        direction: (P, N, 3) unit, in the world, contiguous.
        density: (P, N) per steradian, > 0; that of the mixture.
    """

    direction: torch.Tensor
    density: torch.Tensor


def orthonormal_basis(normal: torch.Tensor) -> torch.Tensor:
    """(P, 3) unit normals to (P, 3, 3) right-handed frames; columns are tangent, bitangent, normal (Duff et al. 2017, no singularity)."""
    x, y, z = normal.unbind(-1)
    sign = torch.where(z < 0, -1.0, 1.0).to(z.dtype)
    a = -1 / (sign + z)
    b = x * y * a
    tangent = torch.stack([1 + sign * x * x * a, sign * b, -sign * x], -1)
    return torch.stack([tangent, torch.stack([b, sign + y * y * a, -y], -1), normal], -1)


@cache
def point_set(count: int) -> torch.Tensor:
    """(count, 2) float64 points of low discrepancy on the unit torus: a golden-ratio lattice."""
    i = torch.arange(count, dtype=torch.float64)
    return torch.stack([(i * 0.6180339887498949) % 1, (i + 0.5) / max(count, 1)], -1)


@cache
def _points(count: int, dtype: torch.dtype, device: torch.device) -> torch.Tensor:
    return point_set(count).to(device, dtype)


def draw(
    view: torch.Tensor,
    normal: torch.Tensor,
    roughness: torch.Tensor,
    counts: tuple[int, int, int],
    light: LightDistribution,
    shift: torch.Tensor | torch.Generator,
    method: str = "mis",
    light_only: bool = False,
) -> Samples:
    """Directions to gather light from at P surface points.

    Args:
        view: (P, 3) unit, towards the eye. normal: (P, 3) unit. roughness: (P,) in 0..1.
        counts: how many cosine, GGX visible-normal and light-map samples; N is their sum.
        light: the light's distribution, made of the map as it is now.
        shift: (P, 2) in [0, 1), by which each point's sets are shifted on the torus (Cranley and Patterson 1976), or what draws it.
        method: "mis", or "stratified": N strata of the hemisphere, uniform, light and lobe unheeded.
        light_only: of the N samples make the last ones, those by the light map; their density is that of the whole mixture all the same.

    Returns:
        Samples. Those below the horizon count in N and bring nothing.
    """
    if method not in METHODS:
        raise ValueError(f"method {method!r} is none of {', '.join(METHODS)}")
    if sum(counts) < 1 or min(counts) < 0:
        raise ValueError(f"counts {counts} make no sample")
    with torch.no_grad():
        if isinstance(shift, torch.Generator):
            shift = torch.rand(len(view), 2, generator=shift, dtype=view.dtype, device=shift.device)
        frame, shift = orthonormal_basis(normal), shift.to(view)
        if method == "stratified":
            local = _uniform(_shifted(sum(counts), shift))
            return Samples(local @ frame.mT, torch.full(local.shape[:2], 0.5 / math.pi, dtype=view.dtype, device=view.device))
        local_view = facing(view, normal)[:, None] @ frame
        plain = view.dtype == torch.float32 and not by_warp(view)
        first = counts[0] + counts[1] if light_only else 0
        return (_mixture if plain else _mixture_reference)(local_view, frame, ggx_alpha(roughness), counts, first, light, shift)


def _mixture(local_view, frame, alpha, counts, first: int, light: LightDistribution, shift) -> Samples:
    """One pass of a kernel; float32 on the CPU."""
    made = sum(counts) - first
    direction, density = torch.empty(len(frame), made, 3), torch.empty(len(frame), made)
    points = [t.contiguous().numpy() for t in (frame, local_view[:, 0], alpha, shift, *map(point_set, counts))]
    lights = [t.contiguous().numpy() for t in (light.rows, light.columns, light.edges, light.texels, direction, density)]
    run_ranges(draw_range, even_ranges(len(frame), 4 * thread_count()), *points, first, *lights)
    return Samples(direction, density.clamp_(min=DENSITY_FLOOR))


def _mixture_reference(local_view, frame, alpha, counts, first: int, light: LightDistribution, shift) -> Samples:
    """The twin in plain operations, for any floating type and device; local_view: (P, 1, 3)."""
    n_c, n_g, n_e = counts
    alpha = alpha[:, None]
    half = sample_visible_normal(local_view, alpha, _shifted(n_g, shift))
    mirrored = 2 * (local_view * half).sum(-1, keepdim=True) * half - local_view
    local = torch.cat([_cosine(_shifted(n_c, shift)), mirrored], 1)
    direction = torch.cat([local @ frame.mT, light.sample(_shifted(n_e, shift))], 1)
    direction = torch.nn.functional.normalize(direction[:, first:], dim=-1)
    local = direction @ frame
    density = n_e * light.density(direction)
    density += (n_c / math.pi) * local[..., 2].clamp_min(0)
    density += n_g * visible_normal_density(local_view, local, alpha)
    return Samples(direction, (density / sum(counts)).clamp_min(DENSITY_FLOOR))


def _shifted(count: int, shift: torch.Tensor) -> torch.Tensor:
    """(P, count, 2) the point set, shifted for each of P points."""
    u = _points(count, shift.dtype, shift.device)[None] + shift[:, None]
    return u - (u >= 1).to(u)


def _cosine(u: torch.Tensor) -> torch.Tensor:
    """(..., 2) to (..., 3) local directions of density cos / pi."""
    r, phi = u[..., 0].sqrt(), 2 * math.pi * u[..., 1]
    return torch.stack([r * phi.cos(), r * phi.sin(), (1 - u[..., 0]).clamp_min(0).sqrt()], -1)


def _uniform(u: torch.Tensor) -> torch.Tensor:
    """(..., 2) to (..., 3) local directions, uniform over the hemisphere, in strata of height."""
    z, phi = u[..., 1], 2 * math.pi * u[..., 0]
    r = (1 - z * z).clamp_min(0).sqrt()
    return torch.stack([r * phi.cos(), r * phi.sin(), z], -1)
