# SPDX-License-Identifier: GPL-3.0-or-later
"""What a relighter asks of the scene along secondary rays; the mesh and the Gaussians both answer."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import torch

from .primary_hits import PrimaryHits


@dataclass(frozen=True, eq=False)
class Hits:
    """What K of the asked rays meet; the others see the light.

    Attributes:
        ray: (K,) which rays, ascending.
        opacity: (K,) in 0..1, how much of the light behind is hidden.
        albedo: (K, 3); roughness, metallic: (K,): materials of what is met.
        normal: (K, 3) unit, turned against the ray.
    """

    ray: torch.Tensor
    opacity: torch.Tensor
    albedo: torch.Tensor
    roughness: torch.Tensor
    metallic: torch.Tensor
    normal: torch.Tensor


class SurfaceQuery(Protocol):
    """A scene that rays can be asked about."""

    def origins(self, surface: PrimaryHits) -> torch.Tensor:
        """(P, 3) where rays from a view's surface points have to start so that they don't meet that very surface."""
        ...

    def hits(self, origin: torch.Tensor, direction: torch.Tensor) -> Hits:
        """What rays meet; origin, direction: (R, 3) float32, directions unit."""
        ...

    def hidden(self, origin: torch.Tensor, direction: torch.Tensor) -> torch.Tensor:
        """(R,) float32 in 0..1, how much of the light behind is hidden: the opacity of `hits`, 0 where there is none, and cheaper."""
        ...
