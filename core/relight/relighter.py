# SPDX-License-Identifier: GPL-3.0-or-later
"""The object under any light: the rendering equation at every pixel, with shadows and one bounce of indirect light.

L_i = V L_new + (1 - V) SplitSum(a, r, m, n of what hides it, prefiltered L_new)
"""

from __future__ import annotations

import dataclasses
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Literal
from weakref import WeakKeyDictionary

import numpy as np
import torch

from ..errors import InputError
from ..machine.backend import by_warp
from ..machine.gpu_memory import rays_that_fit
from ..scene.camera import Camera
from ..scene.reconstruction import Reconstruction
from ..settings.schema import SkipSettings
from ..shading.sampling import Samples, draw
from .adaptive_sampling import PILOT, ROUNDS, noise
from .denoise import Guides, denoised
from .direct_light import add_light_samples
from .estimate import estimated
from .indirect_light import Points, SecondaryRays, Surroundings, gather, trace_samples
from .mesh_query import MeshQuery
from .prepared_light import PreparedLight
from .primary_hits import PrimaryHits, primary_hits
from .sample_counts import Counts, pixel_shifts, sample_counts
from .secondary_query import SurfaceQuery
from .visibility_cache import VisibilityCache, survey

RAYS = 1 << 17  # at a time: few enough for the cache, enough for every thread
KEPT_BYTES = 1 << 28  # of secondary rays that are kept from light to light


@dataclass(frozen=True)
class RelightSettings:
    """How images under a light are made.

    Attributes:
        samples: "hq", "efficient" or the number per pixel.
        sampling: "mis", or "stratified" for comparison.
        denoise: "demodulated", "paper" or "off".
        indirect: light that other parts of the object reflect; without it they only cast shadows.
        conserving: the diffuse lobe gets what the specular one leaves (Blender's Principled); False: all (the paper).
        mesh_normals: how much of the shading normals is the mesh's, 0..1, where a mesh is known.
        albedo_scale: per channel, for all albedo; under an unknown light its brightness can't be known.
        skip: `open` ("off": every ray is traced) and `kept` ("off": nothing stays from light to light), see `SkipSettings`.
        error: of the sRGB image, see adaptive.py; every tile gets the samples that it takes, instead of `samples`. None: of no concern.
    """

    samples: str | int = "hq"
    sampling: Literal["mis", "stratified"] = "mis"
    denoise: Literal["demodulated", "paper", "off"] = "demodulated"
    indirect: bool = True
    conserving: bool = True
    mesh_normals: float = 0.5
    albedo_scale: tuple[float, float, float] = (1.0, 1.0, 1.0)
    skip: SkipSettings = field(default_factory=SkipSettings)
    error: float | None = None


class Tally(Counter[str]):
    """Rays of all images: "traced", "kept" from another light, "open" where others met nothing; "samples" of "pixels" by `error`."""

    def add(self, kind: str, count: int) -> None:
        """Count more of them."""
        self[kind] += count

    def __str__(self) -> str:
        """One line for a person."""
        every = self["traced"] + self["kept"] + self["open"]
        said = f"{self['traced'] / 1e6:.1f} of {every / 1e6:.1f} million rays traced"
        why = [f"{self[kind] / 1e6:.1f} {text}" for kind, text in (("kept", "kept from another light"), ("open", "free")) if self[kind]]
        said += f" ({', '.join(why)})" if why else ""
        return said + (f"; {self['samples'] / self['pixels']:.0f} samples a pixel" if self["pixels"] else "")


@dataclass(frozen=True, eq=False)
class Lasting:
    """What stays of some points of a surface from light to light.

    Attributes:
        shift: (P, 2) of the points' samples. rays: those that no light has a say in. openness: what they tell of those that one has.
    """

    points: Points
    shift: torch.Tensor
    rays: SecondaryRays
    visibility_cache: VisibilityCache

    @property
    def size(self) -> int:
        """Bytes in memory."""
        return self.rays.size + self.visibility_cache.size + 48 * len(self.shift)


class Relighter:
    """Renders views of a reconstruction; the same view under the same light is always the same image, bit by bit.

    Args:
        reconstruction: what cameras see. query: what secondary rays meet. mesh: whose normals better those of the Gaussians, if any.
    """

    def __init__(
        self, reconstruction: Reconstruction, query: SurfaceQuery, settings: RelightSettings, mesh: MeshQuery | None = None
    ) -> None:
        self.reconstruction, self.query, self.settings, self.mesh = reconstruction, query, settings, mesh
        if settings.error is not None and settings.denoise == "paper":
            raise InputError("--error", "the paper's filter errs the same whatever the samples", "use another denoiser")
        self.counts = sample_counts(settings.samples, is_glossy(reconstruction))
        self.device = reconstruction.environment.device
        self._scale = torch.tensor(settings.albedo_scale, device=self.device)
        self._kept: WeakKeyDictionary[PrimaryHits, dict[int, Lasting]] = WeakKeyDictionary()
        self._guides: WeakKeyDictionary[PrimaryHits, Guides] = WeakKeyDictionary()
        self.tally = Tally()
        self.reached = 0.0  # error of the last image, where one was asked for

    def scaled(self, albedo_scale: Sequence[float] | np.ndarray | None) -> Relighter:
        """The same with another factor (3,) of the albedo; None: as it is."""
        if albedo_scale is None:
            return self
        r, g, b = (float(factor) for factor in albedo_scale)
        settings = dataclasses.replace(self.settings, albedo_scale=(r, g, b))
        return Relighter(self.reconstruction, self.query, settings, self.mesh)

    def surface(self, camera: Camera) -> PrimaryHits:
        """What `camera` sees, to be lit by `relit`, once or under several lights."""
        surface = primary_hits(self.reconstruction, camera, self._scale)
        if self.mesh is not None and self.settings.mesh_normals > 0:
            surface = self.mesh.refined(surface, self.settings.mesh_normals)
        return dataclasses.replace(surface, origin=self.query.origins(surface))

    def relit(self, surface: PrimaryHits, light: PreparedLight) -> torch.Tensor:
        """(H, W, 4) linear premultiplied RGBA of a surface under a light, on the CPU. Another light on it is cheaper than the first."""
        return self._relit(surface, light.to(self.device)).cpu()

    def _relit(self, surface: PrimaryHits, light: PreparedLight) -> torch.Tensor:
        if light.distribution is None:
            return surface.composite(torch.zeros_like(surface.albedo))
        with torch.no_grad():
            if self.settings.error is not None:
                return surface.composite(self._to_error(surface, light, self.settings.error))
            sums = self._sums(surface, self.counts, light)
            estimate = estimated(sums, sum(self.counts), surface, light, self.settings.conserving)
            return surface.composite(denoised(estimate, surface, self._guides_of(surface), self.settings.denoise))

    def _to_error(self, surface: PrimaryHits, light: PreparedLight, error: float) -> torch.Tensor:
        """(P, 3) colours, with as many samples in each tile as it takes."""
        sums, samples = self._sums(surface, self._counts(PILOT), light), torch.full_like(surface.index, PILOT)
        for left in reversed(range(ROUNDS)):
            estimate = estimated(sums, samples[:, None], surface, light, self.settings.conserving)
            colour = denoised(estimate, surface, self._guides_of(surface), self.settings.denoise)
            raw, split = estimate.diffuse + estimate.specular, estimate.diffuse_split + estimate.specular_split
            about = noise(raw, split, colour, samples, surface, self.settings.denoise != "off")
            self.reached = about.error()
            if self.reached <= error or not left:
                break
            needed = about.needed(error)[about.tile]
            for count in needed[needed > samples].unique().tolist():
                which = torch.nonzero((needed == count) & (needed > samples))[:, 0]
                sums[which] = self._sums(surface.only(which), self._counts(count), light)
                samples[which] = count
        self.tally.add("samples", int(samples.sum()))
        self.tally.add("pixels", len(samples))
        return colour

    def _counts(self, samples: int) -> Counts:
        return sample_counts(samples, is_glossy(self.reconstruction))

    def _guides_of(self, surface: PrimaryHits) -> Guides:
        if surface not in self._guides:
            kept = self.settings.skip.cache_rays != "off" and self._room() >= Guides.kept_size(surface)
            self._guides[surface] = Guides(surface, self.reconstruction.bound.radius, kept)
        return self._guides[surface]

    def _sums(self, surface: PrimaryHits, counts: Counts, light: PreparedLight) -> torch.Tensor:
        """(P, 2, 12) sums over samples, see `gather`."""
        rays = rays_that_fit(self.device) if by_warp(surface.index) else RAYS
        count, step = len(surface.index), max(1, rays // sum(counts))
        parts = [slice(begin, begin + step) for begin in range(0, count, step)] or [slice(0, 0)]
        return torch.cat([self._gathered(surface, part, counts, light) for part in parts])

    def _gathered(self, surface: PrimaryHits, part: slice, counts: Counts, light: PreparedLight) -> torch.Tensor:
        """The same of some of the points."""
        by_light = counts[2] if self.settings.sampling == "mis" else 0
        lasting = self._lasting(surface, part, counts, light)
        sums = gather(lasting.rays, light, by_light)
        if by_light:
            above, traced = add_light_samples(sums, lasting.points, lasting.shift, counts, light, lasting.visibility_cache, self.query)
            self.tally.add("traced", traced)
            self.tally.add("open", above - traced)
        return sums

    def _lasting(self, surface: PrimaryHits, part: slice, counts: Counts, light: PreparedLight) -> Lasting:
        """What no light has a say in; kept for the next light where memory allows."""
        kept = self._kept.setdefault(surface, {})
        if part.start in kept:
            self.tally.add("kept", kept[part.start].rays.traced)
            return kept[part.start]
        lasting = self._traced(surface, part, counts, light)
        self.tally.add("traced", lasting.rays.traced)
        if self.settings.skip.cache_rays != "off" and lasting.size <= self._room():
            kept[part.start] = lasting
        return lasting

    def _room(self) -> int:
        """Bytes that may still be kept."""
        rays = sum(one.size for parts in self._kept.values() for one in parts.values())
        return KEPT_BYTES - rays - sum(guides.size for guides in self._guides.values())

    def _traced(self, surface: PrimaryHits, part: slice, counts: Counts, light: PreparedLight) -> Lasting:
        assert light.distribution is not None
        shift = pixel_shifts(surface.index[part], surface.camera.width)
        arguments = (surface.view[part], surface.normal[part], surface.roughness[part])
        counts = (*counts[:2], 0) if self.settings.sampling == "mis" else counts
        drawn = draw(*arguments, counts, light.distribution, shift, self.settings.sampling)
        points = Points.of(surface.origin[part], *arguments)
        around = Surroundings(self.query, self._scale if self.settings.indirect else None, self.settings.conserving)
        rays = trace_samples(around, points, Samples(drawn.direction, drawn.density * sum(counts)))
        if self.settings.skip.reuse_visibility == "off" or self.settings.sampling != "mis":
            return Lasting(points, shift, rays, VisibilityCache.unknown(len(shift)))
        return Lasting(points, shift, rays, survey(drawn.direction, rays, surface.index[part], surface.camera.width))


def is_glossy(reconstruction: Reconstruction) -> bool:
    """True where most of the object reflects like metal: its light comes from few directions, and fewer samples do."""
    g = reconstruction.gaussians
    with torch.no_grad():
        weight = g.opacity.sigmoid() * (g.log_scale.sum(0)).exp()  # area
        return float((weight * g.materials()[4]).sum() / weight.sum().clamp_min(1e-30)) > 0.5
