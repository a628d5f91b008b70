# SPDX-License-Identifier: GPL-3.0-or-later
"""Secondary rays with what they meet, which no light changes, and the light that they gather for the surface seen."""

from __future__ import annotations

import math
from dataclasses import dataclass, fields

import torch

from ..kernels.gathering import gather_range
from ..kernels.pool import even_ranges, run_ranges, thread_count
from ..shading.brdf import base_reflectance, facing, ggx_alpha, specular_lobe
from ..shading.lightmap import direction_to_uv, lookup
from ..shading.sampling import Samples
from ..shading.specular_albedo import diffuse_share, specular_albedo
from ..shading.split_sum import reflect, stack_level
from .lighting import PreparedLight
from .query import Hits, SurfaceQuery

SUMS = 12  # three channels each: diffuse, F0, Fresnel, and diffuse as if every ray were free


@dataclass(frozen=True, eq=False)
class SecondaryRays:
    """M rays from each of P points; K of them meet something.

    Attributes:
        direction: (P, M, 3) unit. density: (P, M) per steradian, times the number of all samples; see `gather` for what it may lack.
        row: (P, M) int32, which hit, -1 for none. opacity: (K,) of the hits.
        body, gloss: (K, 3) what a hit sends back along the ray of its irradiance / pi and of its prefiltered mirror light.
        place: (K, 5) u, v of its normal, u, v of the mirrored ray, level in the specular stack.
    """

    direction: torch.Tensor
    density: torch.Tensor
    row: torch.Tensor
    opacity: torch.Tensor
    body: torch.Tensor
    gloss: torch.Tensor
    place: torch.Tensor

    @property
    def size(self) -> int:
        """Bytes in memory."""
        tensors = (getattr(self, field.name) for field in fields(self))
        return sum(tensor.numel() * tensor.element_size() for tensor in tensors)


def trace_samples(
    query: SurfaceQuery, origin: torch.Tensor, normal: torch.Tensor, samples: Samples, scale: torch.Tensor | None, conserving: bool
) -> SecondaryRays:
    """Trace the samples of P points that lie above the horizon.

    Args:
        origin, normal: (P, 3). scale: (3,) factors of what is met's albedo; None: it only casts shadows.
        conserving: of its diffuse lobe, see `reflect_light`.
    """
    direction = samples.direction
    count = direction.shape[1]
    above = torch.nonzero((direction @ normal[..., None])[..., 0].flatten() > 0)[:, 0]
    rays = direction.view(-1, 3)[above]
    hits = query.hits(origin[above // count], rays)
    row = torch.full((direction.shape[0] * count,), -1, dtype=torch.int32)
    row[above[hits.ray]] = torch.arange(len(hits.ray), dtype=torch.int32)
    lobes = _lobes(hits, -rays[hits.ray], scale, conserving)
    return SecondaryRays(direction, samples.density, row.view(-1, count), hits.opacity.contiguous(), *lobes)


def _lobes(hits: Hits, view: torch.Tensor, scale: torch.Tensor | None, conserving: bool) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
    """body, gloss and place of what rays against `view` (K, 3) meet: split-sum shading without its light."""
    if scale is None:
        return torch.zeros_like(view), torch.zeros_like(view), torch.zeros(len(view), 5)
    n_v = (view * hits.normal).sum(-1).clamp(1e-3, 1)
    albedo, metallic = hits.albedo * scale, hits.metallic[:, None]
    body = (1 - metallic) * albedo
    if conserving:
        body = body * diffuse_share(n_v, hits.roughness)[:, None]
    gloss = specular_albedo(n_v, hits.roughness, base_reflectance(albedo, metallic))
    places = (*direction_to_uv(hits.normal), *direction_to_uv(reflect(view, hits.normal)), stack_level(hits.roughness))
    return body.contiguous(), gloss.contiguous(), torch.stack(places, 1)


def gather(
    view: torch.Tensor, normal: torch.Tensor, roughness: torch.Tensor, rays: SecondaryRays, light: PreparedLight, share: float
) -> torch.Tensor:
    """(P, 2, SUMS) float32: sums of light over samples 0, 2, 4.. and 1, 3, 5.., each by its weight in the rendering equation over density.

    Args:
        view, normal: (P, 3) unit. roughness: (P,). share: times the light's own density comes to that of the rays, which all in all
            must be the density of all samples times their number.
    """
    assert light.distribution is not None
    sums = torch.zeros(len(view), 2, SUMS)
    ours = (facing(view, normal), normal, ggx_alpha(roughness), rays.direction, rays.density)
    met = (rays.row, rays.opacity, rays.body, rays.gloss, rays.place)
    theirs = (light.radiance[None], light.diffuse[None], light.specular, light.distribution.texels)
    arrays = [tensor.contiguous().numpy() for tensor in (*ours, *met, *theirs)]
    run_ranges(gather_range, even_ranges(len(view), 4 * thread_count()), *arrays, share, sums.numpy())
    return sums


def gather_reference(
    view: torch.Tensor, normal: torch.Tensor, roughness: torch.Tensor, rays: SecondaryRays, light: PreparedLight, share: float
) -> torch.Tensor:
    """The twin of `gather` in plain operations, in double precision."""
    assert light.distribution is not None
    direction = rays.direction.double()
    free = lookup(light.radiance.double(), direction.view(-1, 3))
    seen = free.clone()
    met = torch.nonzero(rays.row.flatten() >= 0)[:, 0]
    k = rays.row.flatten()[met].long()
    behind = rays.body[k] * _at(light.diffuse[None], rays.place[k, :2], torch.zeros(len(k)))
    behind = behind + rays.gloss[k] * _at(light.specular, rays.place[k, 2:4], rays.place[k, 4])
    seen[met] += rays.opacity[k, None] * (behind - free[met])
    view, normal = facing(view, normal).double(), normal.double()
    n_l, value, power = specular_lobe(view, normal, ggx_alpha(roughness).double(), direction)
    weight = n_l.clamp_min(0) / (rays.density.double() + share * light.distribution.density(rays.direction))
    terms = (
        torch.stack([weight, value * (1 - power) * weight, value * power * weight], -1)[..., None]
        * seen.view(*direction.shape)[..., None, :]
    )
    terms = torch.cat([terms, (weight[..., None] * free.view_as(direction))[..., None, :]], -2).flatten(2)
    return torch.stack([terms[:, 0::2].sum(1), terms[:, 1::2].sum(1)], 1)


def _at(stack: torch.Tensor, place: torch.Tensor, level: torch.Tensor) -> torch.Tensor:
    """(K, 3) values of a stack (L, H, W, 3) at u, v and level."""
    phi, theta = (0.5 - place[:, 0]) * (2 * math.pi), place[:, 1] * math.pi
    direction = torch.stack([theta.sin() * phi.cos(), theta.sin() * phi.sin(), theta.cos()], -1)
    return lookup(stack.double(), direction.double(), level.double())
