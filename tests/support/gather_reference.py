# SPDX-License-Identifier: GPL-3.0-or-later
"""Sums of light along secondary rays in PyTorch operations: reference of `gather` in `core/relight/indirect_light.py`."""

import math

import torch
from irgspp.core.relight.indirect_light import SecondaryRays
from irgspp.core.relight.prepared_light import PreparedLight
from irgspp.core.shading.environment_lookup import lookup


def gather_reference(
    rays: SecondaryRays, light: PreparedLight, light_map_samples: float, vertex_light: torch.Tensor | None = None
) -> torch.Tensor:
    """Compute `gather` in PyTorch operations, in double precision.

    Args:
        rays: traced rays of P points.
        light: the light, possibly rotated.
        light_map_samples: number of light-map samples per point, see `gather`.
        vertex_light: (V, 4), see `gather`.

    Returns:
        (P, 2, SUMS) float64 sums.
    """
    assert light.distribution is not None
    u, v, *lobes, density = rays.terms.double().unbind(-1)
    direction = _direction_of(u + light.turn, v)
    free = lookup(light.radiance.double(), direction.view(-1, 3))
    hit = torch.nonzero(rays.row.flatten() >= 0)[:, 0]
    k, hits = rays.row.flatten()[hit].long(), rays.hits
    mirrored = _lookup_rotated(light.specular, hits.place[k, 2:4], light.turn, hits.place[k, 4])
    if vertex_light is None:
        irradiance = _lookup_rotated(light.diffuse[None], hits.place[k, :2], light.turn, torch.zeros(len(k)))
    else:
        at_hits = torch.einsum("kc,kca->ka", hits.weight[k].double(), vertex_light.double()[hits.corner[k].long()])
        irradiance, mirrored = at_hits[:, :3], at_hits[:, 3:] * mirrored
    reflected = hits.diffuse[k] * irradiance + hits.specular[k] * mirrored
    own_density, hidden = density.flatten()[hit, None], hits.opacity[k, None]
    free = free / (density + light_map_samples * light.distribution.density(direction)).view(-1, 1)
    seen = free.index_copy(0, hit, (1 - hidden) * free[hit] + hidden * reflected / own_density)
    seen, free = (torch.where(lobes[0].view(-1, 1) > 0, each, 0.0).view_as(direction) for each in (seen, free))
    terms = torch.cat([*(lobe[..., None] * seen for lobe in lobes), lobes[0][..., None] * free], -1)
    return torch.stack([terms[:, 0::2].sum(1), terms[:, 1::2].sum(1)], 1)


def _direction_of(u: torch.Tensor, v: torch.Tensor) -> torch.Tensor:
    """Return the unit directions (..., 3) of lat-long coordinates u and v, (...,) each in 0..1."""
    phi, theta = (0.5 - u) * (2 * math.pi), v * math.pi
    return torch.stack([theta.sin() * phi.cos(), theta.sin() * phi.sin(), theta.cos()], -1)


def _lookup_rotated(stack: torch.Tensor, place: torch.Tensor, turn: float, level: torch.Tensor) -> torch.Tensor:
    """Look a stack (L, H, W, 3) up at u, v (K, 2), rotated by `turn`, and level (K,); return (K, 3)."""
    return lookup(stack.double(), _direction_of(place[:, 0] + turn, place[:, 1]).double(), level.double())
