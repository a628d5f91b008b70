# SPDX-License-Identifier: GPL-3.0-or-later
"""Secondary rays traced on the Gaussians: materials composited along the ray."""

from __future__ import annotations

import torch

from ..kernels.trace import build_tree, trace
from ..scene.reconstruction import Reconstruction
from .primary_hits import PrimaryHits
from .secondary_query import Hits

OFFSET = 0.02  # of the scene radius: the mean depth lies inside the layer of surfels of a surface, and rays start above that layer
MAX_FREE_OPACITY = 1 / 255  # opacity at or below which a ray counts as free


class GaussianQuery:
    """Gaussians of a reconstruction as a `SurfaceQuery`; those outside its bound are a backdrop and are ignored.

    Args:
        reconstruction: Gaussians and bound.
        offset: distance of ray origins from the surface, as a fraction of the scene radius.
    """

    def __init__(self, reconstruction: Reconstruction, offset: float = OFFSET) -> None:
        g, bound = reconstruction.gaussians, reconstruction.bound
        with torch.no_grad():
            inside = (g.position - g.position.new_tensor(bound.centre)[:, None]).norm(dim=0) <= bound.radius
            self._surfels = g.select(inside)
            self._materials = self._surfels.materials()
        self._geometry = (self._surfels.position, self._surfels.quaternion, self._surfels.log_scale, self._surfels.opacity)
        self._tree = build_tree(*self._geometry)
        self._offset = offset * bound.radius

    def origins(self, surface: PrimaryHits) -> torch.Tensor:
        """Return ray origins (P, 3) above a surface, see `SurfaceQuery`."""
        return surface.point + self._offset * surface.normal

    def hits(self, origin: torch.Tensor, direction: torch.Tensor) -> Hits:
        """Return the hits of rays, see `SurfaceQuery`.

        Args:
            origin: (R, 3) world, float32.
            direction: (R, 3) unit, float32.
        """
        with torch.no_grad():
            sums = self._traced(self._materials, origin, direction)
            ray = torch.nonzero(sums[:, -1] > MAX_FREE_OPACITY)[:, 0]
            hit = sums[ray]
            opacity = hit[:, -1]
            mean = hit / opacity[:, None]
            normal = torch.nn.functional.normalize(mean[:, 3:6], dim=1)
            point = origin[ray] + mean[:, -2:-1] * direction[ray] + self._offset * normal
        return Hits(ray, opacity, mean[:, 6:9], mean[:, 9].contiguous(), mean[:, 10], normal, point)

    def hidden(self, origin: torch.Tensor, direction: torch.Tensor, reach: torch.Tensor | None = None) -> torch.Tensor:
        """Return the occlusion (R,) of rays, see `SurfaceQuery`; a ray's Gaussians count as one surface at their mean distance.

        Args:
            origin: (R, 3) world, float32.
            direction: (R, 3) unit, float32.
            reach: (R,) distances up to which occluders count, float32; None: all occluders.
        """
        with torch.no_grad():
            distance, opacity = self._traced(self._materials[:0], origin, direction)[:, -2:].unbind(1)
        counts = opacity > MAX_FREE_OPACITY if reach is None else (opacity > MAX_FREE_OPACITY) & (distance < reach * opacity)
        return torch.where(counts, opacity, 0.0)

    def _traced(self, channels: torch.Tensor, origin: torch.Tensor, direction: torch.Tensor) -> torch.Tensor:
        """Trace rays with `trace`, without spherical harmonics.

        Args:
            channels: (E, N) extra channels of the surfels.
            origin: (R, 3) world.
            direction: (R, 3) unit.
        """
        return trace(*self._geometry, None, channels, origin.contiguous(), direction.contiguous(), self._tree)
