# SPDX-License-Identifier: GPL-3.0-or-later
"""Relighting in which the object does not hide the light from itself, for comparison: L_i = L_env + L_reflected."""

from __future__ import annotations

from dataclasses import dataclass, replace

import torch

from .indirect_light import SecondaryRays, gather
from .prepared_light import PreparedLight
from .primary_hits import PrimaryHits
from .secondary_query import Hits, SurfaceQuery


@dataclass(frozen=True)
class WithoutShadows:
    """Scene that reflects light as another one and casts no shadows.

    Attributes:
        scene: the other one.
    """

    scene: SurfaceQuery

    def origins(self, surface: PrimaryHits) -> torch.Tensor:
        """Return the ray origins of the scene."""
        return self.scene.origins(surface)

    def hits(self, origin: torch.Tensor, direction: torch.Tensor) -> Hits:
        """Return the hits of the scene; see `SurfaceQuery.hits`."""
        return self.scene.hits(origin, direction)

    def hidden(self, origin: torch.Tensor, direction: torch.Tensor, reach: torch.Tensor | None = None) -> torch.Tensor:
        """Return 0 for each of R rays; see `SurfaceQuery.hidden`."""
        return origin.new_zeros(len(origin))


def gather_unoccluded(
    rays: SecondaryRays, light: PreparedLight, light_map_samples: float, vertex_light: torch.Tensor | None = None
) -> torch.Tensor:
    """Sum the light along rays as `gather`, but with the light map seen through the surfaces that rays hit: L_i = L_env + L_reflected.

    What surfaces reflect is the difference between the sums with them and with black ones. Arguments and result are those of `gather`.
    """
    hits, nothing = rays.hits, torch.zeros_like(rays.hits.diffuse)
    black = replace(rays, hits=replace(hits, diffuse=nothing, specular=nothing))
    free = gather(replace(rays, row=torch.full_like(rays.row, -1)), light, light_map_samples)
    return free + gather(rays, light, light_map_samples, vertex_light) - gather(black, light, light_map_samples, vertex_light)
