# SPDX-License-Identifier: GPL-3.0-or-later
"""Ray tracer of 2D Gaussians under a light map that estimates outgoing radiance as the second stage does."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import torch
from irgspp.core.kernels.cpu.bvh import SurfelTree
from irgspp.core.kernels.trace import COLOUR, EXTRA, NORMAL, trace, transmittance
from irgspp.core.scene.gaussians import Gaussians
from irgspp.core.scene.spherical_harmonics import SH_C0
from irgspp.core.shading.environment_lookup import lookup
from irgspp.core.shading.light_distribution import LightDistribution
from irgspp.core.shading.rendering_equation import reflect_light
from irgspp.core.shading.sampling import draw

RAYS = 1 << 18  # traced at a time
INNER = 4  # a hit of a secondary ray is shaded with so many times fewer samples; the mean is the same


@dataclass(frozen=True)
class Points:
    """Surface points, one row each.

    Attributes:
        position: (P, 3).
        normal: (P, 3) unit.
        view: (P, 3) unit, towards the eye.
        albedo: (P, 3).
        roughness: (P,).
        metallic: (P,).
        shine: (P,) 0 where the specular lobe is left out (Diffuse BSDF), else 1.
    """

    position: torch.Tensor
    normal: torch.Tensor
    view: torch.Tensor
    albedo: torch.Tensor
    roughness: torch.Tensor
    metallic: torch.Tensor
    shine: torch.Tensor

    def __len__(self) -> int:
        return len(self.position)

    def at(self, index: torch.Tensor | slice) -> Points:
        """Return some of the points, by indices (K,), a mask (P,) or a slice."""
        return Points(*(value[index] for value in vars(self).values()))

    def batches(self, samples: int) -> Iterator[Points]:
        """Yield the points in batches of about RAYS rays."""
        step = max(1, RAYS // samples)
        return (self.at(slice(i, i + step)) for i in range(0, len(self), step))


class TracedScene:
    """Gaussians under a light map, whose outgoing radiance is estimated as in the second stage."""

    def __init__(
        self, gaussians: Gaussians, shine: torch.Tensor, light: np.ndarray, offset: float, conserving: bool, seed: int = 0
    ) -> None:
        """Build the ray tracer and the distribution of the light.

        Args:
            gaussians: surfels of the scene, N.
            shine: (N,), see Points.
            light: linear lat-long map (H, W, 3).
            offset: distance above a surface at which rays start.
            conserving: True where the diffuse lobe gets what the specular one leaves, see `reflect_light`.
            seed: seed of the samples.
        """
        g = self.gaussians = gaussians
        self.offset, self.conserving = offset, conserving
        self.tree = SurfelTree.build(g.position, g.quaternion, g.log_scale, g.opacity)
        self.extra = torch.cat([g.materials(), shine[None]])
        self.light = torch.as_tensor(light, dtype=torch.float32)
        self.distribution = LightDistribution(self.light)
        self.generator = torch.Generator().manual_seed(seed)

    def first_hits(self, origin: torch.Tensor, direction: torch.Tensor) -> tuple[Points, torch.Tensor, torch.Tensor]:
        """Return what rays meet first.

        Args:
            origin: (R, 3).
            direction: (R, 3) unit.

        Returns:
            Surface points, the Gaussians' own radiance (R, 3, a sum), and opacity (R,).
        """
        g = self.gaussians
        sums = trace(g.position, g.quaternion, g.log_scale, g.opacity, g.sh, self.extra, origin, direction, self.tree, degree=0)
        mean = sums[:, :-1] / sums[:, -1:].clamp_min(1e-6)
        normal = torch.nn.functional.normalize(mean[:, NORMAL], dim=-1)
        albedo, (roughness, metallic, shine, distance) = mean[:, EXTRA : EXTRA + 3], mean[:, EXTRA + 3 :].T
        position = origin + distance[:, None] * direction
        return Points(position, normal, -direction, albedo, roughness, metallic, shine), sums[:, COLOUR], sums[:, -1]

    def prepare(self, samples: int) -> None:
        """Set the radiance of every Gaussian to its diffusely reflected direct light, for later bounces."""
        g, m = self.gaussians, self.gaussians.materials().T
        normal = g.normals().T.contiguous()
        points = Points(g.position.T.contiguous(), normal, normal, m[:, :3], m[:, 3], m[:, 4], torch.zeros(g.count))
        g.sh[0] = (self.shade(points, samples, bounces=0).T - 0.5) / SH_C0

    def shade(self, points: Points, samples: int, bounces: int) -> torch.Tensor:
        """Return outgoing radiance (P, 3).

        Args:
            points: P surface points.
            samples: light samples per point.
            bounces: bounces of indirect light, 0 or 1.
        """
        return torch.cat([torch.add(*self._reflect(some, samples, bounces)) for some in points.batches(samples)])

    def _reflect(self, points: Points, samples: int, bounces: int) -> tuple[torch.Tensor, torch.Tensor]:
        """Return diffuse and specular radiance (P, 3)."""
        quarter = max(1, samples // 4)
        counts = samples - 2 * quarter, quarter, quarter
        drawn = draw(points.view, points.normal, points.roughness, counts, self.distribution, self.generator)
        above = (drawn.direction * points.normal[:, None]).sum(-1) > 0
        row = torch.nonzero(above)[:, 0]
        direction = drawn.direction[above]
        origin = points.position[row] + self.offset * points.normal[row]
        incoming = torch.zeros(*above.shape, 3)
        incoming[above] = self._incoming(origin, direction, samples, bounces)
        surface = points.albedo, points.roughness, points.metallic
        diffuse, specular = reflect_light(points.view, points.normal, *surface, drawn, incoming, self.conserving)
        return diffuse, specular * points.shine[:, None]

    def _incoming(self, origin: torch.Tensor, direction: torch.Tensor, samples: int, bounces: int) -> torch.Tensor:
        """Return incident radiance L_i = V L_env + L_ind, (R, 3)."""
        sky = lookup(self.light, direction)
        if not bounces:
            return transmittance(self.tree, origin, direction)[:, None] * sky
        points, radiance, opacity = self.first_hits(origin, direction)
        met = torch.nonzero((opacity > 0.01) & (points.shine > 0.01))[:, 0]
        mirrored = torch.zeros_like(radiance)
        if len(met):
            mirrored[met] = opacity[met, None] * self._mirrored(points.at(met), max(4, samples // INNER))
        return (1 - opacity[:, None]) * sky + radiance + mirrored

    def _mirrored(self, points: Points, samples: int) -> torch.Tensor:
        """Return direct light that leaves by the specular lobe, (P, 3): it depends on the direction, so that no Gaussian can store it."""
        return torch.cat([self._reflect(some, samples, 0)[1] for some in points.batches(samples)])


def traced_image(scene: TracedScene, view, mask: np.ndarray, samples: int, bounces: int) -> np.ndarray:
    """Render the Gaussians at some pixels.

    Args:
        scene: scene to render.
        view: camera of H x W pixels.
        mask: pixels to render (H, W).
        samples: light samples per pixel.
        bounces: bounces of indirect light, 0 or 1.

    Returns:
        (H, W, 3) linear radiance, 0 elsewhere.

    Raises:
        RuntimeError: where the surfels leave holes.
    """
    rays = torch.nn.functional.normalize(torch.from_numpy(view.rays()[mask]), dim=-1)
    origin = torch.tensor(view.centre, dtype=torch.float32).expand_as(rays).contiguous()
    points, _, opacity = scene.first_hits(origin, rays)
    if float(opacity.min()) < 0.99:
        raise RuntimeError("the surfels leave holes; use more of them")
    image = np.zeros((*mask.shape, 3), np.float32)
    image[mask] = scene.shade(points, samples, bounces).numpy()
    return image
