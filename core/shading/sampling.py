# SPDX-License-Identifier: GPL-3.0-or-later
"""Multiple importance sampling of incoming light: cosine, GGX visible-normal and light-map samples, or plain strata for comparison.

The mixture is deterministic: q = (N_c p_c + N_g p_g + N_e p_e) / N is evaluated at every sample whichever strategy drew it, which is
the balance heuristic (Veach 1997, chapter 9). p_c = n.l / pi, p_g = G1(v) D(h) / (4 n.v) (Heitz 2018), p_e as in
`light_distribution.py`. Directions and densities are detached: gradients flow through the BRDF, the light and the cosine only.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cache

import torch

from ..kernels.cpu.directions import draw_range
from ..machine.backend import by_warp
from ..machine.thread_pool import even_ranges, run_ranges, thread_count
from .brdf import bend_view_to_normal, ggx_alpha, sample_visible_normal, visible_normal_density
from .light_distribution import LightDistribution

METHODS = ("mis", "stratified")
DENSITY_FLOOR = 1e-9  # keeps weights finite where a density underflows; far below densities that matter


@dataclass(frozen=True, eq=False)
class Samples:
    """N sampled directions at each of P points.

    Attributes:
        direction: (P, N, 3) unit, world, contiguous.
        density: (P, N) density of the mixture per steradian, > 0.
    """

    direction: torch.Tensor
    density: torch.Tensor


def orthonormal_basis(normal: torch.Tensor) -> torch.Tensor:
    """Return right-handed frames (P, 3, 3) of unit normals (P, 3); columns are tangent, bitangent, normal.

    Branchless construction without a singularity (Duff et al. 2017).
    """
    x, y, z = normal.unbind(-1)
    sign = torch.where(z < 0, -1.0, 1.0).to(z.dtype)
    a = -1 / (sign + z)
    b = x * y * a
    tangent = torch.stack([1 + sign * x * x * a, sign * b, -sign * x], -1)
    return torch.stack([tangent, torch.stack([b, sign + y * y * a, -y], -1), normal], -1)


@cache
def point_set(count: int) -> torch.Tensor:
    """Return `count` points of low discrepancy on the unit torus, (count, 2) float64: a golden-ratio lattice."""
    i = torch.arange(count, dtype=torch.float64)
    return torch.stack([(i * 0.6180339887498949) % 1, (i + 0.5) / max(count, 1)], -1)


def cosine_directions(normal: torch.Tensor, count: int, shift: torch.Tensor) -> torch.Tensor:
    """Draw directions of density cos / pi about normals, (P, count, 3) unit.

    Args:
        normal: (P, 3) unit.
        count: directions per normal.
        shift: (P, 2) shifts of the point sets on the torus, in [0, 1).
    """
    return _cosine(shifted_points(count, shift)) @ orthonormal_basis(normal).mT


@cache
def points_on(count: int, dtype: torch.dtype, device: torch.device) -> torch.Tensor:
    """Return `point_set` as a floating type on a device."""
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
    """Sample directions at P surface points.

    Args:
        view: (P, 3) unit, towards the eye.
        normal: (P, 3) unit.
        roughness: (P,) in 0..1.
        counts: numbers of cosine, GGX visible-normal and light-map samples; N is their sum.
        light: distribution of the current light map.
        shift: (P, 2) in [0, 1), the shift of each point's sets on the torus (Cranley and Patterson 1976), or a generator to draw it from.
        method: "mis", or "stratified": N strata of the hemisphere, uniform, independent of the light and the BRDF.
        light_only: return only the light-map samples, which are the last ones; their density is still that of the whole mixture.

    Returns:
        Samples. Those below the horizon count in N and contribute nothing.

    Raises:
        ValueError: when the method is unknown, or a count is negative or all are 0.
    """
    if method not in METHODS:
        raise ValueError(f"unknown sampling method {method!r}; use one of {', '.join(METHODS)}")
    if sum(counts) < 1 or min(counts) < 0:
        raise ValueError(f"the sample counts {counts} must be >= 0 and not all 0")
    with torch.no_grad():
        if isinstance(shift, torch.Generator):
            shift = torch.rand(len(view), 2, generator=shift, dtype=view.dtype, device=shift.device)
        shift, first = shift.to(view), counts[0] + counts[1] if light_only else 0
        if method == "mis" and view.dtype == torch.float32 and by_warp(view):
            return _mixture_on_gpu(view, normal, ggx_alpha(roughness), counts, first, light, shift)
        frame = orthonormal_basis(normal)
        if method == "stratified":
            local = _uniform(shifted_points(sum(counts), shift))
            return Samples(local @ frame.mT, torch.full(local.shape[:2], 0.5 / math.pi, dtype=view.dtype, device=view.device))
        local_view = bend_view_to_normal(view, normal)[:, None] @ frame
        mixture = _mixture if view.dtype == torch.float32 else _mixture_reference
        return mixture(local_view, frame, ggx_alpha(roughness), counts, first, light, shift)


def _mixture(local_view, frame, alpha, counts, first: int, light: LightDistribution, shift) -> Samples:
    """Draw the mixture by the numba kernel, in float32 on the CPU.

    Args:
        local_view: (P, 1, 3) view in the local frame.
        frame: (P, 3, 3) local frames, columns tangent, bitangent, normal.
        alpha: (P,) of GGX.
        counts: samples of each strategy.
        first: number of the first sample to return.
        light: distribution of the light map.
        shift: (P, 2) shifts on the torus.
    """
    drawn = sum(counts) - first
    direction, density = torch.empty(len(frame), drawn, 3), torch.empty(len(frame), drawn)
    points = [t.contiguous().numpy() for t in (frame, local_view[:, 0], alpha, shift, *map(point_set, counts))]
    tables = [t.contiguous().numpy() for t in (light.rows, light.columns, light.edges, light.texels, direction, density)]
    run_ranges(draw_range, even_ranges(len(frame), 4 * thread_count()), *points, first, *tables)
    return Samples(direction, density.clamp_(min=DENSITY_FLOOR))


def _mixture_on_gpu(view, normal, alpha, counts, first: int, light: LightDistribution, shift) -> Samples:
    """Draw the mixture by the Warp kernel; arguments as of `_mixture`, but for view and normal (P, 3) in place of local ones."""
    from ..kernels.warp.directions import draw_mixture  # Warp is an optional dependency

    points = [points_on(count, torch.float64, view.device) for count in counts]
    tables = [light.rows, light.columns, light.edges, light.texels]
    return Samples(*draw_mixture(view, normal, alpha, shift, points, first, tables, DENSITY_FLOOR))


def _mixture_reference(local_view, frame, alpha, counts, first: int, light: LightDistribution, shift) -> Samples:
    """Draw the mixture in PyTorch operations, for any floating type and device: the reference of `_mixture`, same arguments."""
    n_c, n_g, n_e = counts
    alpha = alpha[:, None]
    half = sample_visible_normal(local_view, alpha, shifted_points(n_g, shift))
    mirrored = 2 * (local_view * half).sum(-1, keepdim=True) * half - local_view
    local = torch.cat([_cosine(shifted_points(n_c, shift)), mirrored], 1)
    direction = torch.cat([local @ frame.mT, light.sample(shifted_points(n_e, shift))], 1)
    direction = torch.nn.functional.normalize(direction[:, first:], dim=-1)
    local = direction @ frame
    density = n_e * light.density(direction)
    density += (n_c / math.pi) * local[..., 2].clamp_min(0)
    density += n_g * visible_normal_density(local_view, local, alpha)
    return Samples(direction, (density / sum(counts)).clamp_min(DENSITY_FLOOR))


def shifted_points(count: int, shift: torch.Tensor) -> torch.Tensor:
    """Return `point_set` shifted for each of P points, (P, count, 2) in [0, 1).

    Args:
        count: points of the set.
        shift: (P, 2) shifts on the torus, in [0, 1).
    """
    u = points_on(count, shift.dtype, shift.device)[None] + shift[:, None]
    return u - (u >= 1).to(u)


def _cosine(u: torch.Tensor) -> torch.Tensor:
    """Map uniform numbers (..., 2) to local directions (..., 3) of density cos / pi."""
    r, phi = u[..., 0].sqrt(), 2 * math.pi * u[..., 1]
    return torch.stack([r * phi.cos(), r * phi.sin(), (1 - u[..., 0]).clamp_min(0).sqrt()], -1)


def _uniform(u: torch.Tensor) -> torch.Tensor:
    """Map uniform numbers (..., 2) to local directions (..., 3), uniform over the hemisphere, in strata of height."""
    z, phi = u[..., 1], 2 * math.pi * u[..., 0]
    r = (1 - z * z).clamp_min(0).sqrt()
    return torch.stack([r * phi.cos(), r * phi.sin(), z], -1)
