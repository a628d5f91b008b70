# SPDX-License-Identifier: GPL-3.0-or-later
"""Secondary rays traced on the mesh: closest hits with interpolated vertex materials."""

from __future__ import annotations

import dataclasses
from functools import cached_property

import numpy as np
import torch

from ..scene.mesh import Mesh
from .mesh_tracer import mesh_tracer
from .primary_hits import PrimaryHits
from .secondary_query import Hits
from .vertex_transfer import VertexTransfer

# Fractions of the scene radius:
CLEARANCE = 0.002  # distance of ray origins from the mesh
OFFSET = 0.012  # distance of ray origins from the Gaussians' surface, where the pixel does not see the mesh
MAX_DEPTH_BEHIND = 0.05  # a pixel sees the mesh where it lies in front of the Gaussians' surface, or behind it by less than this


class MeshQuery:
    """Mesh as a `SurfaceQuery`: every hit is opaque.

    Args:
        mesh: triangles with materials at their vertices.
        radius: scene radius, the unit of the offsets.
        device: device that rays come from.

    Attributes:
        device: device that rays come from.
    """

    def __init__(self, mesh: Mesh, radius: float, device: torch.device | str = "cpu") -> None:
        self._faces, self._radius = torch.from_numpy(mesh.faces.astype(np.int64)).to(device), radius
        rows = (mesh.normals, mesh.albedo, mesh.roughness[:, None], mesh.metallic[:, None])
        self._attributes = torch.from_numpy(np.concatenate(rows, 1, dtype=np.float32)).to(device)
        self._tracer, self._mesh, self.device = mesh_tracer(mesh, device), mesh, device
        self._kept: tuple[torch.Tensor, tuple[torch.Tensor, torch.Tensor, torch.Tensor]] | None = None  # points of a view, what they see

    @cached_property
    def transfer(self) -> VertexTransfer:
        """Radiance transfer of the vertices, traced at the first use."""
        return VertexTransfer(self._mesh, self._tracer, self._radius, self.device)

    def origins(self, surface: PrimaryHits) -> torch.Tensor:
        """Return ray origins (P, 3), see `SurfaceQuery`.

        They lie above the mesh where the pixel sees it: the Gaussians' surface lies inside the mesh in some places and outside in others.
        """
        ray, _, distance = self._seen(surface)
        origin = surface.point + OFFSET * self._radius * surface.normal
        on_mesh = _centre(surface) - distance[:, None] * surface.view[ray]
        return origin.index_copy(0, ray, on_mesh + CLEARANCE * self._radius * surface.normal[ray])

    def refined(self, surface: PrimaryHits, weight: float) -> PrimaryHits:
        """Blend the shading normals of a surface with those of the mesh: their errors have little in common.

        Args:
            surface: P points of a view.
            weight: fraction of the mesh's normal in 0..1; the rest is the Gaussians'.

        Returns:
            The surface with normals (P, 3) changed where the pixel sees the mesh.
        """
        ray, of_mesh, _ = self._seen(surface)
        normal = (1 - weight) * surface.normal[ray] + weight * of_mesh
        normal = torch.nn.functional.normalize(normal, dim=1)
        return dataclasses.replace(surface, normal=surface.normal.index_copy(0, ray, normal))

    def hits(self, origin: torch.Tensor, direction: torch.Tensor) -> Hits:
        """Return the hits of rays, see `SurfaceQuery`.

        Args:
            origin: (R, 3) world, float32.
            direction: (R, 3) unit, float32.
        """
        return self._closest(origin, direction)[0]

    def hidden(self, origin: torch.Tensor, direction: torch.Tensor, reach: torch.Tensor | None = None) -> torch.Tensor:
        """Return the occlusion (R,) of rays, see `SurfaceQuery`.

        Args:
            origin: (R, 3) world, float32.
            direction: (R, 3) unit, float32.
            reach: (R,) distances up to which occluders count, float32; None: all occluders.
        """
        return self._tracer.meet(origin, direction, reach).float()

    def _seen(self, surface: PrimaryHits) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
        """Find the pixels of a view that see the mesh at or in front of the Gaussians' surface; kept for a next call with the same points.

        In front of it: at a silhouette before another surface, a pixel's mean depth lies between both, often inside the nearer one.

        Returns:
            Indices of the pixels (K,), the mesh's normals there (K, 3), and the distances (K,).
        """
        kept = self._kept
        if kept is None or kept[0] is not surface.point:
            direction, centre = -surface.view, _centre(surface)
            hits, distance = self._closest(centre.expand_as(direction).contiguous(), direction)
            near = distance < (surface.point[hits.ray] - centre).norm(dim=1) + MAX_DEPTH_BEHIND * self._radius
            kept = self._kept = surface.point, (hits.ray[near], hits.normal[near], distance[near])
        return kept[1]

    def _closest(self, origin: torch.Tensor, direction: torch.Tensor) -> tuple[Hits, torch.Tensor]:
        """Return the hits of rays (R, 3) and their distances (K,)."""
        triangle, u, v, distance = self.closest(origin, direction)
        ray = torch.nonzero(triangle >= 0)[:, 0]
        barycentric = torch.stack([1 - u[ray] - v[ray], u[ray], v[ray]], 1)
        met = origin[ray] + distance[ray, None] * direction[ray]
        return self._hits(ray, triangle[ray].long(), barycentric, direction, met), distance[ray]

    def closest(self, origin: torch.Tensor, direction: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor, torch.Tensor]:
        """Return the first triangle that each ray meets, without materials.

        Args:
            origin: (R, 3) world, float32.
            direction: (R, 3) unit, float32.

        Returns:
            Triangle index, -1 for none, barycentric u and v, and distance, (R,) each.
        """
        return self._tracer.closest(origin, direction)

    def _hits(
        self, ray: torch.Tensor, triangle: torch.Tensor, barycentric: torch.Tensor, direction: torch.Tensor, met: torch.Tensor
    ) -> Hits:
        """Interpolate the vertex attributes at K hits; `barycentric` and `met`, their positions, are (K, 3)."""
        corner = self._faces[triangle]
        values = torch.einsum("kc,kca->ka", barycentric, self._attributes[corner])
        normal = torch.nn.functional.normalize(values[:, :3], dim=1)
        facing_away = (normal * direction[ray]).sum(1, keepdim=True) > 0
        normal = torch.where(facing_away, -normal, normal)
        surface = (values[:, 3:6], values[:, 6].contiguous(), values[:, 7], normal, met + CLEARANCE * self._radius * normal)
        return Hits(ray, torch.ones_like(values[:, 0]), *surface, corner.int(), barycentric)


def _centre(surface: PrimaryHits) -> torch.Tensor:
    """Return the centre (3,) of a surface's camera."""
    return torch.from_numpy(surface.camera.centre).to(surface.depth)
