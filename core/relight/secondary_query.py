# SPDX-License-Identifier: GPL-3.0-or-later
"""Interface for secondary rays of the relighter, implemented on the mesh and on the Gaussians."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import torch

from .primary_hits import PrimaryHits


@dataclass(frozen=True, eq=False)
class Hits:
    """Hits of K of the traced rays; the other rays see the light.

    Attributes:
        ray: (K,) indices of the rays, ascending.
        opacity: (K,) in 0..1, fraction of the light behind that is occluded.
        albedo: (K, 3) linear, 0..1.
        roughness: (K,) in 0..1.
        metallic: (K,) in 0..1.
        normal: (K, 3) unit, facing the ray; those of Gaussians may lean away by up to 17 degrees (`BEHIND` in kernels/constants.py).
        point: (K, 3) world, above the hit surface: origins of further rays.
        corner: (K, 3) int32 vertices of the triangle hit; None where no mesh was traced.
        weight: (K, 3) barycentric weights of these vertices; None where no mesh was traced.
    """

    ray: torch.Tensor
    opacity: torch.Tensor
    albedo: torch.Tensor
    roughness: torch.Tensor
    metallic: torch.Tensor
    normal: torch.Tensor
    point: torch.Tensor
    corner: torch.Tensor | None = None
    weight: torch.Tensor | None = None


class SurfaceQuery(Protocol):
    """Scene that secondary rays are traced on."""

    def origins(self, surface: PrimaryHits) -> torch.Tensor:
        """Return ray origins (P, 3) for the surface points of a view, offset so that rays do not hit the same surface."""
        ...

    def hits(self, origin: torch.Tensor, direction: torch.Tensor) -> Hits:
        """Return the hits of rays.

        Args:
            origin: (R, 3) world, float32.
            direction: (R, 3) unit, float32.
        """
        ...

    def hidden(self, origin: torch.Tensor, direction: torch.Tensor) -> torch.Tensor:
        """Return the fraction of the light behind that is occluded, (R,) float32 in 0..1.

        It is the opacity of `hits`, 0 without a hit, and cheaper to compute.

        Args:
            origin: (R, 3) world, float32.
            direction: (R, 3) unit, float32.
        """
        ...
