# SPDX-License-Identifier: GPL-3.0-or-later
"""The object under any light: the rendering equation at every pixel, with shadows and one bounce of indirect light.

L_i = V L_new + (1 - V) SplitSum(a, r, m, n of what hides it, prefiltered L_new)
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal
from weakref import WeakKeyDictionary

import numpy as np
import torch

from ..datasets.camera import Camera
from ..scene.reconstruction import Reconstruction
from ..shading.light_distribution import LightDistribution
from ..shading.sampling import Samples, draw
from .denoise import denoised
from .estimate import estimated
from .gathering import SecondaryRays, gather, trace_samples
from .lighting import PreparedLight
from .mesh_query import MeshQuery
from .primary import Primary, primary_surface
from .query import SurfaceQuery
from .samples import pixel_shifts, sample_counts

RAYS = 1 << 17  # at a time: few enough for the cache, enough for every thread
KEPT_BYTES = 1 << 28  # of secondary rays that are kept from light to light


@dataclass(frozen=True)
class RelightSettings:
    """How pictures under a light are made.

    Attributes:
        samples: "hq", "efficient" or the number per pixel.
        sampling: "mis", or "stratified" for comparison.
        denoise: "demodulated", "paper" or "off".
        indirect: light that other parts of the object reflect; without it they only cast shadows.
        conserving: the diffuse lobe gets what the specular one leaves (Blender's Principled); False: all (the paper).
        mesh_normals: how much of the shading normals is the mesh's, 0..1, where a mesh is known.
        albedo_scale: per channel, for all albedo; under an unknown light its brightness can't be known.
    """

    samples: str | int = "hq"
    sampling: Literal["mis", "stratified"] = "mis"
    denoise: Literal["demodulated", "paper", "off"] = "demodulated"
    indirect: bool = True
    conserving: bool = True
    mesh_normals: float = 0.5
    albedo_scale: tuple[float, float, float] = (1.0, 1.0, 1.0)


class Relighter:
    """Renders views of a reconstruction; the same view under the same light is always the same picture, bit by bit.

    Args:
        reconstruction: what cameras see. query: what secondary rays meet. mesh: whose normals better those of the Gaussians, if any.
    """

    def __init__(
        self, reconstruction: Reconstruction, query: SurfaceQuery, settings: RelightSettings, mesh: MeshQuery | None = None
    ) -> None:
        self.reconstruction, self.query, self.settings, self.mesh = reconstruction, query, settings, mesh
        self.counts = sample_counts(settings.samples, is_glossy(reconstruction))
        self._scale = torch.tensor(settings.albedo_scale)
        self._kept: WeakKeyDictionary[Primary, dict[int, SecondaryRays]] = WeakKeyDictionary()

    def scaled(self, albedo_scale: Sequence[float] | np.ndarray | None) -> Relighter:
        """The same with another factor (3,) of the albedo; None: as it is."""
        if albedo_scale is None:
            return self
        r, g, b = (float(factor) for factor in albedo_scale)
        settings = dataclasses.replace(self.settings, albedo_scale=(r, g, b))
        return Relighter(self.reconstruction, self.query, settings, self.mesh)

    def surface(self, camera: Camera) -> Primary:
        """What `camera` sees, to be lit by `relit`, once or under several lights."""
        surface = primary_surface(self.reconstruction, camera, self._scale)
        if self.mesh is not None and self.settings.mesh_normals > 0:
            surface = self.mesh.refined(surface, self.settings.mesh_normals)
        return dataclasses.replace(surface, origin=self.query.origins(surface))

    def relit(self, surface: Primary, light: PreparedLight) -> torch.Tensor:
        """(H, W, 4) linear premultiplied RGBA of a surface under a light. Another light on the same surface is cheaper than the first."""
        if light.distribution is None:
            return surface.composite(torch.zeros(len(surface.index), 3))
        with torch.no_grad():
            sums = torch.cat([self._gathered(surface, part, light) for part in self._parts(surface)])
            estimate = estimated(sums, sum(self.counts), surface, light, self.settings.conserving)
            return surface.composite(denoised(estimate, surface, self.reconstruction.bound.radius, self.settings.denoise))

    def _parts(self, surface: Primary) -> list[slice]:
        """Of the surface's points, one at least."""
        count, step = len(surface.index), max(1, RAYS // sum(self.counts))
        return [slice(begin, begin + step) for begin in range(0, count, step)] or [slice(0, 0)]

    def _gathered(self, surface: Primary, part: slice, light: PreparedLight) -> torch.Tensor:
        """(P, 2, 12) sums over all samples of some of the points, see `gather`."""
        assert light.distribution is not None
        points, shift = (surface.view[part], surface.normal[part], surface.roughness[part]), self._shift(surface, part)
        by_light = self.counts[2] if self.settings.sampling == "mis" else 0
        sums = gather(*points, self._lasting(surface, part, light.distribution), light, by_light)
        if by_light:
            samples = draw(*points, self.counts, light.distribution, shift, light_only=True)
            sums += gather(*points, self._traced(surface, part, samples, sum(self.counts)), light, 0)
        return sums

    def _lasting(self, surface: Primary, part: slice, distribution: LightDistribution) -> SecondaryRays:
        """The rays that no light has a say in; kept for the next light where memory allows."""
        kept = self._kept.setdefault(surface, {})
        if part.start in kept:
            return kept[part.start]
        points, shift = (surface.view[part], surface.normal[part], surface.roughness[part]), self._shift(surface, part)
        mis = self.settings.sampling == "mis"
        counts = (*self.counts[:2], 0) if mis else self.counts
        rays = self._traced(surface, part, draw(*points, counts, distribution, shift, self.settings.sampling), sum(counts))
        if rays.size + sum(other.size for parts in self._kept.values() for other in parts.values()) <= KEPT_BYTES:
            kept[part.start] = rays
        return rays

    def _traced(self, surface: Primary, part: slice, samples: Samples, count: int) -> SecondaryRays:
        """Samples with what they meet; the density is for `count` of them together."""
        samples = Samples(samples.direction, samples.density * count)
        how = (self._scale if self.settings.indirect else None, self.settings.conserving)
        return trace_samples(self.query, surface.origin[part], surface.normal[part], samples, *how)

    @staticmethod
    def _shift(surface: Primary, part: slice) -> torch.Tensor:
        return pixel_shifts(surface.index[part], surface.camera.width)


def is_glossy(reconstruction: Reconstruction) -> bool:
    """True where most of the object reflects like metal: its light comes from few directions, and fewer samples do."""
    g = reconstruction.gaussians
    with torch.no_grad():
        weight = g.opacity.sigmoid() * (g.log_scale.sum(0)).exp()  # area
        return float((weight * g.materials()[4]).sum() / weight.sum().clamp_min(1e-30)) > 0.5
