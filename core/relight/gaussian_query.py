# SPDX-License-Identifier: GPL-3.0-or-later
"""Secondary rays on the Gaussians themselves: their materials composited along the ray."""

from __future__ import annotations

import torch

from ..kernels.trace import build_tree, trace
from ..scene.reconstruction import Reconstruction
from .primary_hits import PrimaryHits
from .secondary_query import Hits

OFFSET = 0.02  # of the scene radius: the mean depth lies inside the cloud of surfels that make a surface, whose thickness this clears
FAINTEST = 1 / 255  # opacity below which a ray counts as free


class GaussianQuery:
    """The Gaussians of a reconstruction as `SurfaceQuery`; those outside its bound, a backdrop, don't count.

    Args:
        reconstruction: whose surfels. offset: of the scene radius, by which rays start above the surface.
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
        """See `SurfaceQuery`."""
        return surface.point + self._offset * surface.normal

    def hits(self, origin: torch.Tensor, direction: torch.Tensor) -> Hits:
        """See `SurfaceQuery`."""
        with torch.no_grad():
            sums = self._traced(self._materials, origin, direction)
            ray = torch.nonzero(sums[:, -1] > FAINTEST)[:, 0]
            at = sums[ray]
            opacity = at[:, -1]
            mean = at / opacity[:, None]
            normal = torch.nn.functional.normalize(mean[:, 3:6], dim=1)
        return Hits(ray, opacity, mean[:, 6:9], mean[:, 9].contiguous(), mean[:, 10], normal)

    def hidden(self, origin: torch.Tensor, direction: torch.Tensor) -> torch.Tensor:
        """See `SurfaceQuery`."""
        with torch.no_grad():
            opacity = self._traced(self._materials[:0], origin, direction)[:, -1]
        return torch.where(opacity > FAINTEST, opacity, 0.0)

    def _traced(self, channels: torch.Tensor, origin: torch.Tensor, direction: torch.Tensor) -> torch.Tensor:
        """See `trace`; channels: (E, N) of the surfels."""
        return trace(*self._geometry, None, channels, origin.contiguous(), direction.contiguous(), self._tree)
