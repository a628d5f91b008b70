# SPDX-License-Identifier: GPL-3.0-or-later
"""Ray tracer for secondary rays through frozen Gaussians: transmittance and radiance along each ray."""

from __future__ import annotations

import torch

from ..kernels.trace import COLOUR, EXTRA, NORMAL, FrozenGaussians, build_tree, trace
from ..machine.backend import by_warp
from ..scene.gaussians import Gaussians, surfels
from ..scene.reconstruction import Reconstruction
from ..scene.surroundings import Surroundings
from ..shading.split_sum import specular_light, specular_radiance

FAINTEST = 1 / 255  # opacity at or below which a ray counts as free
SPREAD, OPAQUE = 0.92, 0.95  # scale of a surfel of the surroundings over its spacing, and its opacity
OFFSET = 0.02  # of the scene radius, along the normal: ray origins lie above the surfels of the surface itself


class SecondaryTracer:
    """Frozen Gaussians of the first stage as occluders and reflectors of the second.

    Args:
        reconstruction: result of the first stage. With split-sum reflections, its SH hold the diffuse radiance only, and the reflections
            are added.
        surroundings: near surfaces that also block rays and reflect light, or None.
        shadows: surfels hide the light behind them; False: for comparison, they only reflect.

    Attributes:
        repack: lay the surfels' channels out again for each call instead of once; for comparison only, since they do not change.
        tree: bounding volume hierarchy of all surfels, which decides what a camera sees. If the photographs show a background, surfels
            outside the bound are a backdrop: part of the distant light, as in the relighter, so that rays from the surface ignore them.
        offset: distance of ray origins from the surface, scene units.
        device: device of the Gaussians.
    """

    def __init__(self, reconstruction: Reconstruction, surroundings: Surroundings | None = None, shadows: bool = True) -> None:
        g, self._shadows = reconstruction.gaussians, shadows
        with torch.no_grad():
            self.tree = build_tree(g.position, g.quaternion, g.log_scale, g.opacity)
            inside, mirrored = inside_bound(reconstruction), reconstruction.mirrored()
            g = g.select(inside)
            materials = g.position.new_zeros(0, g.count) if mirrored is None else mirrored.material[:, inside]
            if surroundings is not None:
                near = surroundings_surfels(surroundings).to(g.position.device)
                matt = near.position.new_tensor((0, 0, 0, 1, 0))[: len(materials), None].expand(-1, near.count)
                g, materials = g.joined(near), torch.cat([materials, matt], 1)
            self._geometry, self._sh, self._materials = (g.position, g.quaternion, g.log_scale, g.opacity), g.sh, materials.contiguous()
            self._stack = None if mirrored is None else specular_light(mirrored.environment)
        self._tree = self.tree if inside.all() and surroundings is None else build_tree(*self._geometry)
        self._packed, self.repack = FrozenGaussians(self._tree, self._sh, self._materials), False
        self.offset, self.device = OFFSET * reconstruction.bound.radius, g.position.device

    def above(self, position: torch.Tensor, normal: torch.Tensor) -> torch.Tensor:
        """Return the origins (P, 3) of secondary rays: surface points moved along their normals by `offset`.

        Args:
            position: (P, 3) surface points, world.
            normal: (P, 3) unit.
        """
        return position + self.offset * normal

    @torch.no_grad()
    def look(self, origin: torch.Tensor, direction: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        """Trace rays through the object.

        Args:
            origin: (R, 3) world.
            direction: (R, 3) unit.

        Returns:
            Transmittance (R,), the fraction of the light behind the object that passes, and the radiance of the object times its opacity,
            (R, 3) linear.
        """
        if self.repack:
            sums = trace(*self._geometry, self._sh, self._materials, origin, direction, self._tree)
        else:
            sums = self._packed.along(origin, direction)
        opacity = sums[:, -1]
        radiance = sums[:, COLOUR].contiguous()
        if self._stack is not None and by_warp(sums):  # all rays: counting the hits would wait for the GPU
            hit = (opacity > FAINTEST)[:, None]
            reflective = self._reflective_radiance(sums / opacity.clamp_min(FAINTEST)[:, None], direction, self._stack)
            radiance = torch.where(hit, reflective * opacity[:, None], radiance)
        elif self._stack is not None:
            hit = torch.nonzero(opacity > FAINTEST)[:, 0]
            radiance[hit] = self._reflective_radiance(sums[hit] / opacity[hit, None], direction[hit], self._stack) * opacity[hit, None]
        return 1 - opacity if self._shadows else torch.ones_like(opacity), radiance

    @staticmethod
    def _reflective_radiance(mean: torch.Tensor, direction: torch.Tensor, stack: torch.Tensor) -> torch.Tensor:
        """Return the diffuse radiance and the reflections of K hit surfaces, (K, 3), from their mean channels.

        Args:
            mean: (K, 13) columns of `trace` divided by opacity.
            direction: (K, 3) unit directions of the rays.
            stack: (L, h, w, 3) prefiltered light of `specular_light`.
        """
        albedo, roughness, metallic = mean[:, EXTRA : EXTRA + 3], mean[:, EXTRA + 3].contiguous(), mean[:, EXTRA + 4]
        normal = torch.nn.functional.normalize(mean[:, NORMAL], dim=1)
        reflected = specular_radiance(-direction, normal, albedo, roughness, metallic, stack)
        return (1 - metallic[:, None]) * mean[:, COLOUR] + reflected


def surroundings_surfels(surroundings: Surroundings) -> Gaussians:
    """Return surroundings as surfels that cover their surfaces."""
    s = surroundings
    return surfels(s.position, s.normal, s.radiance, SPREAD * s.spacing, OPAQUE)


def inside_bound(reconstruction: Reconstruction) -> torch.Tensor:
    """Return (N,) bool, True for surfels of the object: all where the photographs were masked, else those inside the bound."""
    g, bound = reconstruction.gaussians, reconstruction.bound
    if reconstruction.background is None:
        return torch.ones(g.count, dtype=torch.bool, device=g.position.device)
    return (g.position - g.position.new_tensor(bound.centre)[:, None]).norm(dim=0) <= bound.radius
