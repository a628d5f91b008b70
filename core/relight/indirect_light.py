# SPDX-License-Identifier: GPL-3.0-or-later
"""Secondary rays with what they meet, which no light changes, and the light that they gather for the surface seen."""

from __future__ import annotations

import math
from dataclasses import dataclass, fields
from typing import Any

import torch

from ..kernels.cpu.gathering import gather_range, terms_range
from ..machine.backend import by_warp
from ..machine.thread_pool import even_ranges, run_ranges, thread_count
from ..shading.brdf import base_reflectance, facing, ggx_alpha
from ..shading.environment_lookup import direction_to_uv, lookup
from ..shading.sampling import Samples
from ..shading.specular_albedo import diffuse_fraction, specular_albedo
from ..shading.split_sum import reflect, stack_level
from .prepared_light import PreparedLight
from .secondary_query import Hits, SurfaceQuery

SUMS = 12  # three channels each: diffuse, F0, Fresnel, and diffuse as if every ray were free


@dataclass(frozen=True, eq=False)
class Points:
    """P points to be lit, as kernels take them.

    Attributes:
        origin: (P, 3) where rays start. view: (P, 3) unit, on the normal's side. normal: (P, 3) unit. alpha: (P,) of GGX.
    """

    origin: torch.Tensor
    view: torch.Tensor
    normal: torch.Tensor
    alpha: torch.Tensor

    @classmethod
    def of(cls, origin: torch.Tensor, view: torch.Tensor, normal: torch.Tensor, roughness: torch.Tensor) -> Points:
        """From any view vectors (P, 3) and roughness (P,)."""
        return cls(origin.contiguous(), facing(view, normal).contiguous(), normal.contiguous(), ggx_alpha(roughness).contiguous())


@dataclass(frozen=True, eq=False)
class Met:
    """What K rays meet, less the light.

    Attributes:
        opacity: (K,). body, gloss: (K, 3) what a hit sends back along the ray of its irradiance / pi and of its prefiltered mirror light.
        place: (K, 5) u, v of its normal, u, v of the mirrored ray, level in the specular stack.
    """

    opacity: torch.Tensor
    body: torch.Tensor
    gloss: torch.Tensor
    place: torch.Tensor

    @property
    def tensors(self) -> list[torch.Tensor]:
        """For kernels."""
        return [getattr(self, field.name).contiguous() for field in fields(self)]


@dataclass(frozen=True, eq=False)
class Surroundings:
    """How rays are answered: by `query`, and what is met shines by its albedo times `scale` (3,); None: it only casts shadows.

    conserving: of its diffuse lobe, see `reflect_light`.
    """

    query: SurfaceQuery
    scale: torch.Tensor | None
    conserving: bool

    def along(self, origin: torch.Tensor, direction: torch.Tensor) -> tuple[torch.Tensor, Met]:
        """(R,) int32 which hit is each ray's, -1 for none, and the hits; origin, direction: (R, 3)."""
        hits = self.query.hits(origin, direction)
        row = torch.full((len(origin),), -1, dtype=torch.int32, device=origin.device)
        row[hits.ray] = torch.arange(len(hits.ray), dtype=torch.int32, device=origin.device)
        return row, self._met(hits, -direction[hits.ray])

    def _met(self, hits: Hits, view: torch.Tensor) -> Met:
        """What is seen against `view` (K, 3): split-sum shading without its light."""
        if self.scale is None:
            return Met(hits.opacity, torch.zeros_like(view), torch.zeros_like(view), view.new_zeros(len(view), 5))
        n_v = (view * hits.normal).sum(-1).clamp(1e-3, 1)
        albedo, metallic = hits.albedo * self.scale, hits.metallic[:, None]
        body = (1 - metallic) * albedo
        if self.conserving:
            body = body * diffuse_fraction(n_v, hits.roughness)[:, None]
        gloss = specular_albedo(n_v, hits.roughness, base_reflectance(albedo, metallic))
        places = (*direction_to_uv(hits.normal), *direction_to_uv(reflect(view, hits.normal)), stack_level(hits.roughness))
        return Met(hits.opacity, body, gloss, torch.stack(places, 1))


@dataclass(frozen=True, eq=False)
class SecondaryRays:
    """M rays from each of P points, with all that no light changes.

    Attributes:
        terms: (P, M, 6) u, v, cosine, cosine times the specular lobe's two parts, density times the number of all samples; 0 below the
            horizon. row: (P, M) int32, which of the hits `met`, -1 for none.
    """

    terms: torch.Tensor
    row: torch.Tensor
    met: Met

    @property
    def traced(self) -> int:
        """How many of them lie above the horizon."""
        return int((self.terms[..., 2] > 0).sum())

    @property
    def size(self) -> int:
        """Bytes in memory."""
        return sum(t.numel() * t.element_size() for t in (self.terms, self.row, *vars(self.met).values()))


def _device() -> Any:
    """What does the work where warp does: an option, not installed everywhere."""
    from ..kernels.warp import light

    return light


def trace_samples(surroundings: Surroundings, points: Points, samples: Samples) -> SecondaryRays:
    """Trace the samples of P points that lie above the horizon; their density is for all of them together."""
    count = samples.direction.shape[1]
    terms = points.normal.new_empty(len(points.normal), count, 6)
    tensors = (points.view, points.normal, points.alpha, samples.direction.contiguous(), samples.density.contiguous(), terms)
    if by_warp(terms):
        _device().terms(*tensors)
    else:
        run_ranges(terms_range, even_ranges(len(terms), 4 * thread_count()), *(t.numpy() for t in tensors))
    above = torch.nonzero(terms[..., 2].flatten() > 0)[:, 0]
    row = torch.full((terms.shape[0] * count,), -1, dtype=torch.int32, device=terms.device)
    row[above], met = surroundings.along(points.origin[above // count], samples.direction.view(-1, 3)[above])
    return SecondaryRays(terms, row.view(-1, count), met)


def gather(rays: SecondaryRays, light: PreparedLight, share: float) -> torch.Tensor:
    """(P, 2, SUMS) float32: sums of light over samples 0, 2, 4.. and 1, 3, 5.., each by its weight in the rendering equation over density.

    share: times the light's own density comes to that of the rays, where they see the light itself: what samples of the light find
    in their way they leave out, so that it is for these rays alone.
    """
    assert light.distribution is not None
    sums = rays.terms.new_zeros(len(rays.terms), 2, SUMS)
    theirs = (light.radiance[None], light.diffuse[None], light.specular, light.distribution.texels)
    tensors = (rays.terms, rays.row, *rays.met.tensors, *(t.contiguous() for t in theirs))
    if by_warp(sums):
        _device().gather(*tensors, share, light.turn, sums)
    else:
        parts = even_ranges(len(sums), 4 * thread_count())
        run_ranges(gather_range, parts, *(t.numpy() for t in tensors), share, light.turn, sums.numpy())
    return sums


def gather_reference(rays: SecondaryRays, light: PreparedLight, share: float) -> torch.Tensor:
    """The twin of `gather` in plain operations, in double precision."""
    assert light.distribution is not None
    u, v, *lobes, density = rays.terms.double().unbind(-1)
    direction = _direction(u + light.turn, v)
    free = lookup(light.radiance.double(), direction.view(-1, 3))
    hit = torch.nonzero(rays.row.flatten() >= 0)[:, 0]
    k, met = rays.row.flatten()[hit].long(), rays.met
    behind = met.body[k] * _at(light.diffuse[None], met.place[k, :2], light.turn, torch.zeros(len(k)))
    behind = behind + met.gloss[k] * _at(light.specular, met.place[k, 2:4], light.turn, met.place[k, 4])
    own, hidden = density.flatten()[hit, None], met.opacity[k, None]
    free = free / (density + share * light.distribution.density(direction)).view(-1, 1)
    seen = free.index_copy(0, hit, (1 - hidden) * free[hit] + hidden * behind / own)
    seen, free = (torch.where(lobes[0].view(-1, 1) > 0, each, 0.0).view_as(direction) for each in (seen, free))
    terms = torch.cat([*(lobe[..., None] * seen for lobe in lobes), lobes[0][..., None] * free], -1)
    return torch.stack([terms[:, 0::2].sum(1), terms[:, 1::2].sum(1)], 1)


def _direction(u: torch.Tensor, v: torch.Tensor) -> torch.Tensor:
    phi, theta = (0.5 - u) * (2 * math.pi), v * math.pi
    return torch.stack([theta.sin() * phi.cos(), theta.sin() * phi.sin(), theta.cos()], -1)


def _at(stack: torch.Tensor, place: torch.Tensor, turn: float, level: torch.Tensor) -> torch.Tensor:
    """(K, 3) values of a stack (L, H, W, 3) at u, v and level."""
    return lookup(stack.double(), _direction(place[:, 0] + turn, place[:, 1]).double(), level.double())
