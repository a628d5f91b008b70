# SPDX-License-Identifier: GPL-3.0-or-later
"""Secondary rays through the first stage's Gaussians: how much passes, and the radiance of what is in the way."""

from __future__ import annotations

import torch

from ..kernels.bvh import DiskTree
from ..kernels.tracing import COLOUR, EXTRA, NORMAL, trace
from ..scene.reconstruction import Reconstruction
from ..shading.split_sum import specular_light, specular_radiance

OFFSET = 0.02  # of the scene radius, along the normal: clears the disks that make the surface itself


class Tracer:
    """The frozen Gaussians as what casts shadows and reflects light.

    Args:
        reconstruction: of the first stage. Where it is glossy, its SH hold diffuse radiance only, and the reflections are added.
    """

    def __init__(self, reconstruction: Reconstruction) -> None:
        g = reconstruction.gaussians
        with torch.no_grad():
            self._geometry = g.position.detach(), g.quaternion.detach(), g.log_scale.detach(), g.opacity.detach()
            self._sh, mirrored = g.sh.detach(), reconstruction.mirrored()
            self._materials = torch.zeros(0, g.count) if mirrored is None else mirrored.material
            self._stack = None if mirrored is None else specular_light(mirrored.environment)
        self.tree = DiskTree.build(*self._geometry)
        self.offset = OFFSET * reconstruction.bound.radius

    def above(self, position: torch.Tensor, normal: torch.Tensor) -> torch.Tensor:
        """(P, 3) where rays from a surface start."""
        return position + self.offset * normal

    @torch.no_grad()
    def look(self, origin: torch.Tensor, direction: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        """What R rays (R, 3) see: the share of the light behind that passes, (R,), and the object's radiance times its opacity, (R, 3)."""
        sums = trace(*self._geometry, self._sh, self._materials, origin, direction, self.tree)
        opacity = sums[:, -1]
        radiance = sums[:, COLOUR].contiguous()
        if self._stack is not None:
            hit = torch.nonzero(opacity > 1 / 255)[:, 0]
            at = sums[hit] / opacity[hit, None]
            albedo, roughness, metallic = at[:, EXTRA : EXTRA + 3], at[:, EXTRA + 3].contiguous(), at[:, EXTRA + 4]
            normal = torch.nn.functional.normalize(at[:, NORMAL], dim=1)
            reflected = specular_radiance(-direction[hit], normal, albedo, roughness, metallic, self._stack)
            radiance[hit] = ((1 - metallic[:, None]) * at[:, COLOUR] + reflected) * opacity[hit, None]
        return 1 - opacity, radiance
