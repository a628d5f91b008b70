# SPDX-License-Identifier: GPL-3.0-or-later
"""Secondary rays and the light that they gather: L_i = V L_env + (1 - V) L_reflected, as sums over samples.

What does not depend on the light (hits, reflectances, weights) is computed once per surface and kept for the next light. A hit surface
reflects the irradiance of the mesh's vertices around it, and the prefiltered light in the mirror direction (split-sum shading).
"""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from functools import cached_property
from typing import Any

import numpy as np
import torch

from ..kernels.cpu.gathering import gather_range, reflected_range, terms_range
from ..machine.backend import by_warp
from ..machine.thread_pool import even_ranges, run_ranges, thread_count
from ..settings.schema import Brdf
from ..shading.brdf import base_reflectance, bend_view_to_normal, ggx_alpha
from ..shading.environment_lookup import direction_to_uv
from ..shading.sampling import Samples
from ..shading.specular_albedo import diffuse_fraction, specular_albedo
from ..shading.split_sum import reflect, stack_level
from .prepared_light import PreparedLight
from .secondary_query import Hits, SurfaceQuery
from .vertex_transfer import VertexTransfer

SUMS = 12  # three channels each: light for the diffuse lobe, F0, Fresnel, and the diffuse lobe without occlusion
# Columns of `SecondaryRays.terms`, in the order in which the kernels write them:
COSINE, LOBES, DENSITY = 2, slice(2, 5), slice(5, 6)  # LOBES: the cosine alone, and times the two parts of the specular lobe
TERMS = 6


@dataclass(frozen=True, eq=False)
class ShadingPoints:
    """P points to be lit, as kernels read them.

    Attributes:
        origin: (P, 3) origins of secondary rays, world.
        view: (P, 3) unit, towards the eye, on the normal's side.
        normal: (P, 3) unit.
        alpha: (P,) of GGX; of IRGS' BRDF without a lower bound.
        brdf: reflectance model.
    """

    origin: torch.Tensor
    view: torch.Tensor
    normal: torch.Tensor
    alpha: torch.Tensor
    brdf: Brdf = "principled"

    @classmethod
    def from_roughness(
        cls, origin: torch.Tensor, view: torch.Tensor, normal: torch.Tensor, roughness: torch.Tensor, brdf: Brdf = "principled"
    ) -> ShadingPoints:
        """Build the points from unconstrained view vectors.

        Args:
            origin: (P, 3) origins of secondary rays, world.
            view: (P, 3) unit, towards the eye.
            normal: (P, 3) unit.
            roughness: (P,) in 0..1.
            brdf: reflectance model.
        """
        alpha = roughness * roughness if brdf == "irgs" else ggx_alpha(roughness)
        view = bend_view_to_normal(view, normal)
        return cls(origin.contiguous(), view.contiguous(), normal.contiguous(), alpha.contiguous(), brdf)

    @property
    def tensors(self) -> tuple[torch.Tensor, ...]:
        """Return all tensors."""
        return self.origin, self.view, self.normal, self.alpha


@dataclass(frozen=True, eq=False)
class HitReflectance:
    """Reflectance of K hit surfaces towards their rays, independent of the light.

    Attributes:
        opacity: (K,) in 0..1.
        diffuse: (K, 3) factor of the irradiance / pi at the hit.
        specular: (K, 3) factor of the prefiltered light in the mirror direction.
        place: (K, 5) u, v of the normal, u, v of the mirrored ray, level in the specular stack.
        corner: (K, 3) int32 vertices of the mesh around the hit; 0 where their light is not known.
        weight: (K, 3) weights of these vertices.
    """

    opacity: torch.Tensor
    diffuse: torch.Tensor
    specular: torch.Tensor
    place: torch.Tensor
    corner: torch.Tensor
    weight: torch.Tensor

    @property
    def tensors(self) -> list[torch.Tensor]:
        """Return the attributes in order, contiguous, for kernels."""
        return [getattr(self, field.name).contiguous() for field in fields(self)]


@dataclass(frozen=True, eq=False)
class HitSurfaces:
    """K hit surfaces as points that lamps light.

    Attributes:
        points: seen along the rays that met them; their origins lie above the surfaces.
        f0: (K, 3) reflectance of the specular lobe at normal incidence.
    """

    points: ShadingPoints
    f0: torch.Tensor

    @property
    def tensors(self) -> tuple[torch.Tensor, ...]:
        """Return all tensors."""
        return (*self.points.tensors, self.f0)


@dataclass(frozen=True, eq=False)
class SecondaryScene:
    """Scene as secondary rays see it: occluders, with or without the light that they reflect.

    Attributes:
        query: mesh or Gaussians.
        scale: (3,) factor of the albedo of hit surfaces; None: they only cast shadows.
        conserving: reduce their diffuse lobe by what the specular lobe reflects, see `reflect_light`.
        transfer: radiance transfer of the mesh whose vertices light the hit surfaces; None: the unoccluded light does.
        for_lamps: return the hit surfaces as well, for lamps to light them.
        brdf: reflectance model of the hit surfaces.
    """

    query: SurfaceQuery
    scale: torch.Tensor | None
    conserving: bool
    transfer: VertexTransfer | None = None
    for_lamps: bool = False
    brdf: Brdf = "principled"

    def trace(self, origin: torch.Tensor, direction: torch.Tensor) -> tuple[torch.Tensor, HitReflectance, HitSurfaces | None]:
        """Trace rays.

        Args:
            origin: (R, 3) world, float32.
            direction: (R, 3) unit, float32.

        Returns:
            (R,) int32 index of each ray's hit, -1 for none; the reflectances of the K hits; and their surfaces, if asked for.
        """
        hits = self.query.hits(origin, direction)
        if self.brdf == "irgs":  # it has no metal
            hits = replace(hits, metallic=torch.zeros_like(hits.metallic))
        row = torch.full((len(origin),), -1, dtype=torch.int32, device=origin.device)
        row[hits.ray] = torch.arange(len(hits.ray), dtype=torch.int32, device=origin.device)
        view = -direction[hits.ray]
        return row, self._reflectance(hits, view), self._surfaces(hits, view)

    def _surfaces(self, hits: Hits, view: torch.Tensor) -> HitSurfaces | None:
        """Return the hits as points that lamps light; None where that is not asked for."""
        if not self.for_lamps or self.scale is None:
            return None
        points = ShadingPoints.from_roughness(hits.point, view, hits.normal, hits.roughness, self.brdf)
        return HitSurfaces(points, base_reflectance(hits.albedo * self.scale, hits.metallic[:, None]))

    def _reflectance(self, hits: Hits, view: torch.Tensor) -> HitReflectance:
        """Return the reflectance of hits towards `view` (K, 3): split-sum shading without its light."""
        vertices = self._vertices(hits)
        if self.scale is None:
            return HitReflectance(hits.opacity, torch.zeros_like(view), torch.zeros_like(view), view.new_zeros(len(view), 5), *vertices)
        n_v = (view * hits.normal).sum(-1).clamp(1e-3, 1)
        albedo, metallic = hits.albedo * self.scale, hits.metallic[:, None]
        diffuse = (1 - metallic) * albedo
        if self.conserving:
            diffuse = diffuse * diffuse_fraction(n_v, hits.roughness)[:, None]
        specular = specular_albedo(n_v, hits.roughness, base_reflectance(albedo, metallic), self.brdf)
        places = (*direction_to_uv(hits.normal), *direction_to_uv(reflect(view, hits.normal)), stack_level(hits.roughness))
        return HitReflectance(hits.opacity, diffuse, specular, torch.stack(places, 1), *vertices)

    def _vertices(self, hits: Hits) -> tuple[torch.Tensor, torch.Tensor]:
        """Return the vertices around hits, (K, 3) int32, and their weights (K, 3)."""
        if self.transfer is None or self.scale is None:
            nothing = hits.normal.new_zeros(hits.normal.shape)
            return nothing.int(), nothing
        if hits.corner is None or hits.weight is None:
            return self.transfer.nearest(hits.point)
        return hits.corner, hits.weight


@dataclass(frozen=True, eq=False)
class SecondaryRays:
    """M rays from each of P points, with everything that does not depend on the light.

    Attributes:
        terms: (P, M, TERMS) u, v, cosine, cosine times the two parts of the specular lobe, density times the number of all samples; 0 below
            the horizon.
        row: (P, M) int32 index of each ray's hit in `hits`, -1 for none.
        hits: reflectances of the K hits.
        surfaces: the K hits as points that lamps light; None where there are no lamps.
    """

    terms: torch.Tensor
    row: torch.Tensor
    hits: HitReflectance
    surfaces: HitSurfaces | None = None

    @cached_property
    def traced(self) -> int:
        """Count the rays above the horizon."""
        return int((self.terms[..., COSINE] > 0).sum())

    @property
    def size(self) -> int:
        """Return the bytes in memory."""
        tensors = (self.terms, self.row, *vars(self.hits).values(), *(self.surfaces.tensors if self.surfaces else ()))
        return sum(t.numel() * t.element_size() for t in tensors)


def _warp_kernels() -> Any:
    """Return the module of the Warp kernels, imported on demand: Warp is an optional dependency."""
    from ..kernels.warp import light

    return light


def trace_samples(scene: SecondaryScene, points: ShadingPoints, samples: Samples) -> SecondaryRays:
    """Trace the samples of P points that lie above the horizon.

    Args:
        scene: what the rays meet.
        points: the P points.
        samples: (P, M) directions; their density is multiplied by the number of all samples of a point.
    """
    count = samples.direction.shape[1]
    terms = points.normal.new_empty(len(points.normal), count, TERMS)
    tensors = (points.view, points.normal, points.alpha, samples.direction.contiguous(), samples.density.contiguous())
    irgs = points.brdf == "irgs"
    if by_warp(terms):
        _warp_kernels().terms(*tensors, irgs, terms)
    else:
        parts = even_ranges(len(terms), 4 * thread_count())
        run_ranges(terms_range, parts, *(t.numpy() for t in tensors), irgs, terms.numpy())
    above = torch.nonzero(terms[..., COSINE].flatten() > 0)[:, 0]
    row = torch.full((terms.shape[0] * count,), -1, dtype=torch.int32, device=terms.device)
    row[above], hits, surfaces = scene.trace(points.origin[above // count], samples.direction.view(-1, 3)[above])
    return SecondaryRays(terms, row.view(-1, count), hits, surfaces)


def gather(rays: SecondaryRays, light: PreparedLight, light_map_samples: float, vertex_light: torch.Tensor | None = None) -> torch.Tensor:
    """Sum the light along rays, each weighted as in the rendering equation and divided by its density.

    Args:
        rays: traced rays of P points.
        light: the light, possibly rotated.
        light_map_samples: light-map samples per point, drawn separately by `add_light_samples`. So many times the light's own density is
            added to the density of the rays where they see the light itself, but not where they see a hit surface: light-map samples
            add no reflected light, which therefore comes from these rays alone.
        vertex_light: (V, 4) of `VertexTransfer.light`; None: surfaces that rays hit receive the unoccluded light, as in the paper.

    Returns:
        (P, 2, SUMS) float32 sums over samples 0, 2, 4... and over samples 1, 3, 5...
    """
    assert light.distribution is not None
    sums = rays.terms.new_zeros(len(rays.terms), 2, SUMS)
    vertices = sums.new_zeros(0, 4) if vertex_light is None else vertex_light
    hits, texels = (*rays.hits.tensors, vertices), light.distribution.texels
    radiance, diffuse, specular = (t.contiguous() for t in (light.radiance, light.diffuse, light.specular))
    if by_warp(sums):
        maps = (radiance[None], diffuse[None], specular, texels)
        _warp_kernels().gather(rays.terms, rays.row, *hits, *maps, light_map_samples, light.turn, sums)
        return sums
    opacity, *surfaces = (t.numpy() for t in (*hits, diffuse, specular))
    reflected, turn = np.empty((len(opacity), 3), np.float32), np.float32(light.turn)
    run_ranges(reflected_range, even_ranges(len(opacity), 2 * thread_count()), *surfaces, turn, reflected)
    points = (rays.terms.numpy(), rays.row.numpy(), opacity, reflected, radiance.numpy(), texels.numpy())
    run_ranges(gather_range, even_ranges(len(sums), 2 * thread_count()), *points, np.float32(light_map_samples), turn, sums.numpy())
    return sums
