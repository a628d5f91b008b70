# SPDX-License-Identifier: GPL-3.0-or-later
"""Relighter: the object under any light by the rendering equation at every pixel, with shadows and interreflections.

L_i = V L_new + (1 - V) (diffuse albedo E / pi + specular albedo prefiltered L_new) of the occluder, its irradiance E from `VertexTransfer`
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from weakref import WeakKeyDictionary

import numpy as np
import torch

from ..errors import InputError
from ..machine.backend import by_warp
from ..machine.gpu_memory import rays_that_fit
from ..rendering.gbuffer import SUBPIXELS, render_gbuffer
from ..scene.camera import Camera
from ..scene.gbuffer import GBuffer
from ..scene.lamps import Lamp
from ..scene.reconstruction import Reconstruction
from ..settings.schema import Brdf
from ..shading.light_distribution import LightDistribution
from ..shading.sampling import Samples, draw
from ..surface.normal_images import METAL_SURFACE_WEIGHT, SURFACE_WEIGHT
from .denoise import Guides, denoised
from .direct_light import add_light_samples
from .estimate import Estimate, Reflectance, estimate_reflected_light, joined_estimate
from .image_noise import MAX_ROUNDS, PILOT_SAMPLES, estimate_noise
from .indirect_light import SUMS, SecondaryScene, ShadingPoints, gather, trace_samples
from .lamp_light import bounced_sums, lamp_sums, samples_per_lamp
from .mesh_query import MeshQuery
from .prepared_light import PreparedLight
from .primary_hits import DividedHits, PrimaryHits, divided_hits, primary_hits
from .ray_cache import CachedRays, RayCounter
from .relight_settings import RelightSettings
from .sample_counts import SampleCounts, is_mostly_metallic, pixel_shifts, sample_counts
from .secondary_query import SurfaceQuery
from .vertex_transfer import VertexTransfer
from .visibility_cache import VisibilityCache, build_visibility_cache
from .without_shadows import WithoutShadows, gather_unoccluded

RAYS = 1 << 18  # rays traced at a time on the CPU, which bounds the memory; with half as many, frames take 7 to 10 % longer
CACHE_BYTES = 1 << 29  # largest size of what is kept from light to light: secondary rays, and the denoiser's weights


class Relighter:
    """Renderer of a reconstruction under any light; the same view under the same light gives bit-identical images.

    Args:
        reconstruction: Gaussians that cameras see.
        query: scene for secondary rays.
        settings: settings of the images.
        mesh: mesh whose normals and texture refine normals and albedo of the Gaussians, or None.

    Attributes:
        brdf: reflectance model of the images.
        conserving: the diffuse lobe is reduced by what the specular lobe reflects.
        counts: samples of each strategy per pixel.
        device: device of the reconstruction.
        tally: numbers of rays of all images so far.
        estimated_error: estimated error of the last image, if `settings.error` is set.

    Raises:
        InputError: when the settings contradict each other.
    """

    def __init__(
        self, reconstruction: Reconstruction, query: SurfaceQuery, settings: RelightSettings, mesh: MeshQuery | None = None
    ) -> None:
        query = query if settings.shadows or isinstance(query, WithoutShadows) else WithoutShadows(query)
        self.reconstruction, self.query, self.settings, self.mesh = reconstruction, query, settings, mesh
        if settings.error is not None and settings.denoise == "paper":
            raise InputError("--error", "the error of the paper's filter does not fall with more samples", "use another --denoiser")
        self.brdf: Brdf = settings.brdf or reconstruction.brdf
        if self.brdf == "irgs" and settings.conserving:
            what = "conserving is of the principled BRDF, and IRGS' has a full diffuse lobe"
            raise InputError("--diffuse", what, "leave it out, or add --brdf principled")
        self.conserving = self.brdf == "principled" and settings.conserving is not False
        self._mostly_metallic, self.device = is_mostly_metallic(reconstruction), reconstruction.environment.device
        usual = METAL_SURFACE_WEIGHT if self._mostly_metallic else SURFACE_WEIGHT
        self._mesh_normals = usual if settings.mesh_normals is None else settings.mesh_normals
        self.counts = self._counts_of(settings.samples)
        self._rays_at_once = rays_that_fit(self.device) if by_warp(reconstruction.environment) else RAYS
        self._scale = torch.tensor(settings.albedo_scale, device=self.device)
        self._ray_cache: WeakKeyDictionary[PrimaryHits, dict[tuple[SampleCounts, int], CachedRays]] = WeakKeyDictionary()
        self._guides: WeakKeyDictionary[PrimaryHits, Guides] = WeakKeyDictionary()
        self._reflectances: WeakKeyDictionary[PrimaryHits, Reflectance] = WeakKeyDictionary()
        self.tally = RayCounter()
        self.estimated_error = 0.0  # of the last image, if settings.error is set

    def with_albedo_scale(self, albedo_scale: Sequence[float] | np.ndarray | None) -> Relighter:
        """Return the relighter with another factor (3,) of the albedo; None: itself."""
        if albedo_scale is None:
            return self
        r, g, b = (float(factor) for factor in albedo_scale)
        settings = dataclasses.replace(self.settings, albedo_scale=(r, g, b))
        return Relighter(self.reconstruction, self.query, settings, self.mesh)

    def with_samples(self, samples: int) -> Relighter:
        """Return the relighter with another number of samples per pixel."""
        return Relighter(self.reconstruction, self.query, dataclasses.replace(self.settings, samples=samples), self.mesh)

    def surface(self, camera: Camera) -> PrimaryHits:
        """Return the surface that a camera sees, to be lit by `relit` under one or several lights."""
        if not self.settings.divide:
            return self._refined(primary_hits(self.reconstruction, camera, self._scale))
        surface, rays = divided_hits(self.reconstruction, camera, self._scale)
        surface = self._refined(surface)
        if not len(rays.index):
            return surface
        return dataclasses.replace(surface, divided=DividedHits.of(surface, self._refined(rays)))

    def gbuffer(self, camera: Camera, surface: PrimaryHits | None = None, light_rotation: np.ndarray | None = None) -> GBuffer:
        """Return the G-buffer of a camera: the mesh's depth, the normals it is shaded by, the texture's albedo without `albedo_scale`.

        Args:
            camera: the camera.
            surface: the surface that it sees, from `surface`, where that is known.
            light_rotation: of the light that the radiance is of, see `render_gbuffer`.
        """
        buffers = render_gbuffer(self.reconstruction, camera, light_rotation)
        if self.mesh is None:
            return buffers
        surface = surface or self.surface(camera)
        index = surface.index.cpu().numpy()
        layers = {name: getattr(buffers, name).copy() for name in ("normal", "depth", "albedo")}
        layers["normal"].reshape(-1, 3)[index], layers["depth"].reshape(-1)[index] = surface.normal.cpu(), self.mesh.depth(surface).cpu()
        if self.mesh.albedo is not None:
            layers["albedo"].reshape(-1, 3)[index] = (surface.mean_albedo() / self._scale.clamp_min(1e-6)).cpu()
        return dataclasses.replace(buffers, **layers)

    def _refined(self, surface: PrimaryHits) -> PrimaryHits:
        """Return a surface with refined normals and albedo, and with origins of secondary rays."""
        if self.brdf == "irgs":  # it has no metal
            surface = dataclasses.replace(surface, metallic=torch.zeros_like(surface.metallic))
        if self.mesh is not None:
            surface = self.mesh.refined(surface, self._mesh_normals)
            surface = self.mesh.textured(surface, self._scale)
        return dataclasses.replace(surface, origin=self.query.origins(surface))

    def relit(self, surface: PrimaryHits, light: PreparedLight, lamps: Sequence[Lamp] = ()) -> torch.Tensor:
        """Render a surface under a light; further lights on the same surface take less time than the first.

        Args:
            surface: surface that a camera sees, from `surface`.
            light: light from `prepare_light`.
            lamps: lamps that light it as well, in the frame of the reconstruction.

        Returns:
            (H, W, 4) linear premultiplied RGBA, on the CPU.
        """
        return self._relit(surface, light.to(self.device), lamps).cpu()

    def reflected(self, surface: PrimaryHits, light: PreparedLight, lamps: Sequence[Lamp] = ()) -> Estimate:
        """Estimate the diffuse and specular light that points reflect, not denoised; nothing where there is no light.

        Args:
            surface: P points, without metal for IRGS' BRDF.
            light: light from `prepare_light`.
            lamps: lamps that light the points as well.
        """
        return self._reflected(surface, self.counts, light, lamps)

    @torch.no_grad()
    def _reflected(self, surface: PrimaryHits, counts: SampleCounts, light: PreparedLight, lamps: Sequence[Lamp]) -> Estimate:
        """Estimate as `reflected`, with a number of samples of each strategy."""
        if light.distribution is None and not lamps:
            black = torch.zeros_like(surface.albedo)
            return Estimate(black, black, black, black, sum(counts))
        if surface.divided is None:
            return self._estimate(surface, counts, light, lamps)
        single = self._estimate(surface.divided.single, counts, light, lamps)
        of_ray = self._counts_of(max(1, sum(counts) // SUBPIXELS**2))
        return joined_estimate(surface.divided, single, self._estimate(surface.divided.rays, of_ray, light, lamps))

    def _estimate(self, surface: PrimaryHits, counts: SampleCounts, light: PreparedLight, lamps: Sequence[Lamp]) -> Estimate:
        """Estimate the light that points reflect, by as many samples at each."""
        sums = self._sums(surface, counts, light, lamps)
        if surface not in self._reflectances:
            self._reflectances[surface] = Reflectance.of(surface, self.conserving)
        return estimate_reflected_light(sums, sum(counts), self._reflectances[surface], light, self.settings.ratio)

    @torch.no_grad()
    def _relit(self, surface: PrimaryHits, light: PreparedLight, lamps: Sequence[Lamp]) -> torch.Tensor:
        """Render as `relit`, on the device."""
        if light.distribution is None and not lamps:
            return surface.composite(torch.zeros_like(surface.albedo))
        if self.settings.error is not None:
            return surface.composite(self._render_to_error(surface, light, lamps, self.settings.error))
        estimate = self.reflected(surface, light, lamps)
        return surface.composite(denoised(estimate, self._guides_of(surface), self.settings.denoise))

    def _render_to_error(self, surface: PrimaryHits, light: PreparedLight, lamps: Sequence[Lamp], error: float) -> torch.Tensor:
        """Return colours (P, 3) with as many samples per pixel as the requested error needs, which the noise of few samples tells."""
        samples = PILOT_SAMPLES
        for remaining in reversed(range(MAX_ROUNDS)):
            estimate = self._reflected(surface, self._counts_of(samples), light, lamps)
            colour = denoised(estimate, self._guides_of(surface), self.settings.denoise)
            noise = estimate_noise(estimate, colour, surface, self.settings.denoise != "off")
            self.estimated_error = noise.error()
            if self.estimated_error <= error or not remaining or samples == noise.needed(error):
                break
            samples = noise.needed(error)
        self.tally.add("samples", samples * len(surface.index))
        self.tally.add("pixels", len(surface.index))
        return colour

    def _counts_of(self, samples: str | int) -> SampleCounts:
        """Return the samples of each strategy for a number of samples."""
        return sample_counts(samples, self._mostly_metallic, self.settings.allocation)

    def _guides_of(self, surface: PrimaryHits) -> Guides:
        """Return the guide layers of a surface, kept as long as it lives."""
        if surface not in self._guides:
            keep_weights = self.settings.skip.cache_rays != "off" and self._free_bytes() >= Guides.kept_size(surface)
            self._guides[surface] = Guides(surface, self.reconstruction.bound.radius, keep_weights)
        return self._guides[surface]

    def _sums(self, surface: PrimaryHits, counts: SampleCounts, light: PreparedLight, lamps: Sequence[Lamp]) -> torch.Tensor:
        """Return sums over samples (P, 2, 12), see `gather`, and those of lamps if any, computed in parts of limited memory."""
        count, step = len(surface.index), max(1, self._rays_at_once // sum(counts))
        parts = [slice(begin, begin + step) for begin in range(0, count, step)] or [slice(0, 0)]
        transfer = self._transfer if light.distribution is not None else None
        vertex_light = None if transfer is None else transfer.light(light, self._scale)
        return torch.cat([self._gather_part(surface, part, counts, light, lamps, vertex_light) for part in parts])

    @property
    def _transfer(self) -> VertexTransfer | None:
        """Return the radiance transfer that lights hit surfaces; None: the unoccluded light does."""
        return self.mesh.transfer if self.mesh is not None and self.settings.indirect and self.settings.transfer else None

    def _gather_part(
        self,
        surface: PrimaryHits,
        part: slice,
        counts: SampleCounts,
        light: PreparedLight,
        lamps: Sequence[Lamp],
        vertex_light: torch.Tensor | None,
    ) -> torch.Tensor:
        """Return the sums over samples of some of the points."""
        cached = self._cached_rays(surface, part, counts, light, bool(lamps))
        sums = self._map_sums(cached, counts, light, vertex_light)
        if not lamps:
            return sums
        by_lamps = lamp_sums(cached.points, lamps, cached.shift, samples_per_lamp(counts, len(lamps)), self.query)
        if cached.rays.surfaces is not None:
            by_lamps += bounced_sums(cached.rays, lamps, self.query)
        return torch.cat([sums, by_lamps.flatten(2)], -1)

    def _map_sums(self, cached: CachedRays, counts: SampleCounts, light: PreparedLight, vertex_light: torch.Tensor | None) -> torch.Tensor:
        """Return the sums over samples of the light map, 0 where it is black."""
        if light.distribution is None:
            return cached.shift.new_zeros(len(cached.shift), 2, SUMS)
        by_light = counts.light if self.settings.sampling == "mis" else 0
        collect = gather if self.settings.shadows else gather_unoccluded
        sums = collect(cached.rays, light, by_light, vertex_light)
        if by_light:
            above, traced = add_light_samples(sums, cached.points, cached.shift, counts, light, cached.visibility_cache, self.query)
            self.tally.add("traced", traced)
            self.tally.add("open", above - traced)
        return sums

    def _cached_rays(self, surface: PrimaryHits, part: slice, counts: SampleCounts, light: PreparedLight, for_lamps: bool) -> CachedRays:
        """Return what does not depend on the light for some of the points; it is kept for the next light if memory allows."""
        parts = self._ray_cache.setdefault(surface, {})
        key = (counts, part.start)
        kept = parts.pop(key, None)
        if kept is not None and (not for_lamps or kept.rays.surfaces is not None or not self.settings.indirect):
            self.tally.add("kept", kept.rays.traced)
            parts[key] = kept
            return kept
        cached = self._trace_part(surface, part, counts, light, for_lamps)
        self.tally.add("traced", cached.rays.traced)
        if self.settings.skip.cache_rays != "off" and cached.size <= self._free_bytes():
            parts[key] = cached
        return cached

    def _free_bytes(self) -> int:
        """Return the bytes that may still be kept."""
        rays = sum(one.size for parts in self._ray_cache.values() for one in parts.values())
        return CACHE_BYTES - rays - sum(guides.size for guides in self._guides.values())

    def _trace_part(self, surface: PrimaryHits, part: slice, counts: SampleCounts, light: PreparedLight, for_lamps: bool) -> CachedRays:
        """Draw and trace the cosine and visible-normal samples (all samples without MIS) of some of the points."""
        distribution = light.distribution or LightDistribution(light.radiance)  # uniform for a black map
        shift = pixel_shifts(surface.index[part], surface.camera.width)
        arguments = (surface.view[part], surface.normal[part], surface.roughness[part])
        counts = counts._replace(light=0) if self.settings.sampling == "mis" else counts
        drawn = draw(*arguments, counts, distribution, shift, self.settings.sampling)
        points = ShadingPoints.from_roughness(surface.origin[part], *arguments, self.brdf)
        scale = self._scale if self.settings.indirect else None
        scene = SecondaryScene(self.query, scale, self.conserving, self._transfer, for_lamps, self.brdf)
        rays = trace_samples(scene, points, Samples(drawn.direction, drawn.density * sum(counts)))
        if self.settings.skip.reuse_visibility == "off" or self.settings.sampling != "mis":
            return CachedRays(points, shift, rays, VisibilityCache.unknown(len(shift)))
        return CachedRays(points, shift, rays, build_visibility_cache(drawn.direction, rays, surface.index[part], surface.camera.width))
