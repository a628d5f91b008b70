# SPDX-License-Identifier: GPL-3.0-or-later
"""The object under any light: the rendering equation at every pixel, with shadows and one bounce of indirect light.

L_i = V L_new + (1 - V) SplitSum(a, r, m, n of what hides it, prefiltered L_new)
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
import torch

from ..datasets.camera import Camera
from ..scene.reconstruction import Reconstruction
from ..shading.lightmap import lookup
from ..shading.sampling import Samples, draw
from ..shading.split_sum import shade
from ..shading.transport import reflect_light
from .denoise import denoised
from .lighting import PreparedLight
from .mesh_query import MeshQuery
from .primary import Primary, primary_surface
from .query import SurfaceQuery
from .samples import pixel_shifts, sample_counts

RAYS = 1 << 17  # at a time: few enough for the cache, enough for every thread


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
        self.reconstruction, self.query, self.settings, self._mesh = reconstruction, query, settings, mesh
        self.counts = sample_counts(settings.samples, is_glossy(reconstruction))
        self._scale = torch.tensor(settings.albedo_scale)

    def scaled(self, albedo_scale: Sequence[float] | np.ndarray | None) -> Relighter:
        """The same with another factor (3,) of the albedo; None: as it is."""
        if albedo_scale is None:
            return self
        r, g, b = (float(factor) for factor in albedo_scale)
        settings = dataclasses.replace(self.settings, albedo_scale=(r, g, b))
        return Relighter(self.reconstruction, self.query, settings, self._mesh)

    def surface(self, camera: Camera) -> Primary:
        """What `camera` sees, to be lit by `relit`, once or under several lights."""
        surface = primary_surface(self.reconstruction, camera, self._scale)
        if self._mesh is not None and self.settings.mesh_normals > 0:
            surface = self._mesh.refined(surface, self.settings.mesh_normals)
        return dataclasses.replace(surface, origin=self.query.origins(surface))

    def relit(self, surface: Primary, light: PreparedLight) -> torch.Tensor:
        """(H, W, 4) linear premultiplied RGBA of a surface under a light."""
        diffuse, specular = torch.zeros(2, len(surface.index), 3)
        if light.distribution is not None:
            step = max(1, RAYS // sum(self.counts))
            for begin in range(0, len(surface.index), step):
                part = slice(begin, begin + step)
                diffuse[part], specular[part] = self._reflected(surface, part, light)
        if self.settings.denoise == "off":
            return surface.composite(diffuse + specular)
        radius = self.reconstruction.bound.radius
        return surface.composite(denoised(diffuse, specular, surface, radius, self.settings.denoise))

    @torch.no_grad()
    def _reflected(self, surface: Primary, part: slice, light: PreparedLight) -> tuple[torch.Tensor, torch.Tensor]:
        """Diffuse and specular (P, 3) of some of the points."""
        view, normal, roughness = surface.view[part], surface.normal[part], surface.roughness[part]
        shift = pixel_shifts(surface.index[part], surface.camera.width)
        assert light.distribution is not None
        samples = draw(view, normal, roughness, self.counts, light.distribution, shift, self.settings.sampling)
        incoming = self._incoming(surface.origin[part], normal, samples, light)
        materials = (surface.albedo[part], roughness, surface.metallic[part])
        return reflect_light(view, normal, *materials, samples, incoming, self.settings.conserving)

    def _incoming(self, origin: torch.Tensor, normal: torch.Tensor, samples: Samples, light: PreparedLight) -> torch.Tensor:
        """(P, N, 3) radiance along the samples; 0 below the horizon, where it would not count."""
        direction = samples.direction
        above = torch.nonzero((direction @ normal[..., None])[..., 0].flatten() > 0)[:, 0]
        rays = direction.view(-1, 3)[above]
        radiance = lookup(light.radiance, rays)
        hit = self.query.hits(origin[above // direction.shape[1]], rays)
        behind = radiance[hit.ray] * (1 - hit.opacity[:, None])
        if self.settings.indirect:
            materials = (hit.albedo * self._scale, hit.roughness, hit.metallic)
            shaded = shade(-rays[hit.ray], hit.normal, *materials, light.diffuse, light.specular, self.settings.conserving)
            behind = behind + shaded * hit.opacity[:, None]
        radiance[hit.ray] = behind
        return torch.zeros(direction.numel() // 3, 3).index_copy(0, above, radiance).view_as(direction)


def is_glossy(reconstruction: Reconstruction) -> bool:
    """True where most of the object reflects like metal: its light comes from few directions, and fewer samples do."""
    g = reconstruction.gaussians
    with torch.no_grad():
        weight = g.opacity.sigmoid() * (g.log_scale.sum(0)).exp()  # area
        return float((weight * g.materials()[4]).sum() / weight.sum().clamp_min(1e-30)) > 0.5
