# SPDX-License-Identifier: GPL-3.0-or-later
"""Secondary rays on the mesh: the closest hit, vertex materials interpolated."""

from __future__ import annotations

import dataclasses

import numpy as np
import torch

from ..scene.mesh import Mesh
from .primary_hits import PrimaryHits
from .secondary_query import Hits
from .triangles import triangles_of

# Of the scene radius:
CLEARANCE = 0.002  # rays start this much above the mesh,
OFFSET = 0.012  # or above the Gaussians' surface where the mesh is not,
NEAR = 0.05  # which it is where it lies before them, or behind them by less than this


class MeshQuery:
    """A mesh as `SurfaceQuery`: a ray meets it or it does not.

    Args:
        mesh: the mesh. radius: of the scene, which lengths are measured by. device: where rays come from.
    """

    def __init__(self, mesh: Mesh, radius: float, device: torch.device | str = "cpu") -> None:
        self._faces, self._radius = torch.from_numpy(mesh.faces.astype(np.int64)).to(device), radius
        rows = (mesh.normals, mesh.albedo, mesh.roughness[:, None], mesh.metallic[:, None])
        self._attributes = torch.from_numpy(np.concatenate(rows, 1, dtype=np.float32)).to(device)
        self._triangles = triangles_of(mesh, device)

    def origins(self, surface: PrimaryHits) -> torch.Tensor:
        """See `SurfaceQuery`. Rays start on the mesh: the Gaussians' surface lies inside it here and outside there."""
        ray, _, distance = self._seen(surface)
        origin = surface.point + OFFSET * self._radius * surface.normal
        on_mesh = _centre(surface) - distance[:, None] * surface.view[ray]
        return origin.index_copy(0, ray, on_mesh + CLEARANCE * self._radius * surface.normal[ray])

    def refined(self, surface: PrimaryHits, weight: float) -> PrimaryHits:
        """The surface with normals that are `weight` the mesh's and 1 - `weight` the Gaussians': their errors have little in common."""
        ray, hits, _ = self._seen(surface)
        normal = (1 - weight) * surface.normal[ray] + weight * hits.normal
        normal = torch.nn.functional.normalize(normal, dim=1)
        return dataclasses.replace(surface, normal=surface.normal.index_copy(0, ray, normal))

    def hits(self, origin: torch.Tensor, direction: torch.Tensor) -> Hits:
        """See `SurfaceQuery`."""
        return self._closest(origin, direction)[0]

    def hidden(self, origin: torch.Tensor, direction: torch.Tensor) -> torch.Tensor:
        """See `SurfaceQuery`."""
        return self._triangles.meet(origin, direction).float()

    def _seen(self, surface: PrimaryHits) -> tuple[torch.Tensor, Hits, torch.Tensor]:
        """Which of a view's pixels see the mesh where the Gaussians are or before, (K,), what they see there, and its distance (K,).

        Before: along a silhouette that has something behind it a pixel's mean depth lies between both, often inside what is in front.
        """
        direction = -surface.view
        origin = _centre(surface).expand_as(direction).contiguous()
        hits, distance = self._closest(origin, direction)
        near = distance < (surface.point[hits.ray] - origin[hits.ray]).norm(dim=1) + NEAR * self._radius
        chosen = Hits(*(getattr(hits, field.name)[near] for field in dataclasses.fields(hits)))
        return chosen.ray, chosen, distance[near]

    def _closest(self, origin: torch.Tensor, direction: torch.Tensor) -> tuple[Hits, torch.Tensor]:
        """Hits and their distances (K,)."""
        triangle, u, v, distance = self.closest(origin, direction)
        ray = torch.nonzero(triangle >= 0)[:, 0]
        share = torch.stack([1 - u[ray] - v[ray], u[ray], v[ray]], 1)
        return self._hits(ray, triangle[ray].long(), share, direction), distance[ray]

    def closest(self, origin: torch.Tensor, direction: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor, torch.Tensor]:
        """What rays (R, 3) meet first and no more: triangle, -1 for none, u and v in it, distance, (R,) each."""
        return self._triangles.closest(origin, direction)

    def _hits(self, ray: torch.Tensor, triangle: torch.Tensor, share: torch.Tensor, direction: torch.Tensor) -> Hits:
        at = torch.einsum("kc,kca->ka", share, self._attributes[self._faces[triangle]])
        normal = torch.nn.functional.normalize(at[:, :3], dim=1)
        away = (normal * direction[ray]).sum(1, keepdim=True) > 0
        materials = (at[:, 3:6], at[:, 6].contiguous(), at[:, 7])
        return Hits(ray, torch.ones_like(at[:, 0]), *materials, torch.where(away, -normal, normal))


def _centre(surface: PrimaryHits) -> torch.Tensor:
    return torch.from_numpy(surface.camera.centre).to(surface.depth)
