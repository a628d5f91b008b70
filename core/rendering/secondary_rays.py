# SPDX-License-Identifier: GPL-3.0-or-later
"""Secondary rays through the first stage's Gaussians: how much passes, and the radiance of what is in the way."""

from __future__ import annotations

import torch

from ..kernels.trace import COLOUR, EXTRA, NORMAL, Seen, build_tree, trace
from ..machine.backend import by_warp
from ..scene.reconstruction import Reconstruction
from ..shading.split_sum import specular_light, specular_radiance

FAINTEST = 1 / 255  # opacity below which nothing is met
OFFSET = 0.02  # of the scene radius, along the normal: clears the surfels that make the surface itself


class SecondaryTracer:
    """The frozen Gaussians as what casts shadows and reflects light.

    Args:
        reconstruction: of the first stage. Where it is glossy, its SH hold diffuse radiance only, and the reflections are added.

    Attributes:
        repack: lay the surfels' channels out anew for each call, for comparison; they don't change.
        tree: all surfels, as what hides a point from a camera. Where the photographs had a background, surfels outside the bound are a
            backdrop: part of the light, as for the relighter, which rays from the surface don't meet.
    """

    def __init__(self, reconstruction: Reconstruction) -> None:
        g = reconstruction.gaussians
        with torch.no_grad():
            self.tree = build_tree(g.position, g.quaternion, g.log_scale, g.opacity)
            own, mirrored = inside(reconstruction), reconstruction.mirrored()
            g = g.select(own)
            self._geometry, self._sh = (g.position, g.quaternion, g.log_scale, g.opacity), g.sh
            self._materials = g.position.new_zeros(0, g.count) if mirrored is None else mirrored.material[:, own].contiguous()
            self._stack = None if mirrored is None else specular_light(mirrored.environment)
        self._tree = self.tree if own.all() else build_tree(*self._geometry)
        self._seen, self.repack = Seen(self._tree, self._sh, self._materials), False
        self.offset, self.device = OFFSET * reconstruction.bound.radius, g.position.device

    def above(self, position: torch.Tensor, normal: torch.Tensor) -> torch.Tensor:
        """(P, 3) where rays from a surface start."""
        return position + self.offset * normal

    @torch.no_grad()
    def look(self, origin: torch.Tensor, direction: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        """What R rays (R, 3) see: the share of the light behind that passes, (R,), and the object's radiance times its opacity, (R, 3)."""
        if self.repack:
            sums = trace(*self._geometry, self._sh, self._materials, origin, direction, self._tree)
        else:
            sums = self._seen.along(origin, direction)
        opacity = sums[:, -1]
        radiance = sums[:, COLOUR].contiguous()
        if self._stack is not None and by_warp(sums):  # all rays: their number would have to be waited for
            there = (opacity > FAINTEST)[:, None]
            shown = self._shown(sums / opacity.clamp_min(FAINTEST)[:, None], direction, self._stack)
            radiance = torch.where(there, shown * opacity[:, None], radiance)
        elif self._stack is not None:
            hit = torch.nonzero(opacity > FAINTEST)[:, 0]
            radiance[hit] = self._shown(sums[hit] / opacity[hit, None], direction[hit], self._stack) * opacity[hit, None]
        return 1 - opacity, radiance

    @staticmethod
    def _shown(mean: torch.Tensor, direction: torch.Tensor, stack: torch.Tensor) -> torch.Tensor:
        """(K, 3) diffuse radiance and reflections of what rays meet, from means over it (K, 13)."""
        albedo, roughness, metallic = mean[:, EXTRA : EXTRA + 3], mean[:, EXTRA + 3].contiguous(), mean[:, EXTRA + 4]
        normal = torch.nn.functional.normalize(mean[:, NORMAL], dim=1)
        reflected = specular_radiance(-direction, normal, albedo, roughness, metallic, stack)
        return (1 - metallic[:, None]) * mean[:, COLOUR] + reflected


def inside(reconstruction: Reconstruction) -> torch.Tensor:
    """(N,) bool, which surfels are of the object: all where the photographs were masked, else those inside the bound."""
    g, bound = reconstruction.gaussians, reconstruction.bound
    if reconstruction.background is None:
        return torch.ones(g.count, dtype=torch.bool, device=g.position.device)
    return (g.position - g.position.new_tensor(bound.centre)[:, None]).norm(dim=0) <= bound.radius
