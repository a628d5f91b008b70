# SPDX-License-Identifier: GPL-3.0-or-later
"""Rays on triangles: warp's mesh, closest hit."""

import torch
import warp as wp

from .runtime import launch, on_stream

_FAR = wp.constant(3.0e38)


@wp.kernel
def closest(
    mesh: wp.uint64, origin: wp.array(dtype=wp.vec3), direction: wp.array(dtype=wp.vec3), triangle: wp.array(dtype=int),
    u: wp.array(dtype=float), v: wp.array(dtype=float), distance: wp.array(dtype=float),
):  # fmt: skip
    """The nearest triangle of each ray, -1 for none; u and v are the shares of its second and third corner."""
    ray = wp.tid()
    hit = wp.mesh_query_ray(mesh, origin[ray], direction[ray], _FAR)
    triangle[ray] = -1
    if hit.result:
        triangle[ray] = hit.face
        u[ray] = hit.v
        v[ray] = 1.0 - hit.u - hit.v
        distance[ray] = hit.t


class DeviceMesh:
    """A mesh that rays can be asked about; vertices (V, 3) float32, faces (F, 3), on the device."""

    def __init__(self, vertices: torch.Tensor, faces: torch.Tensor) -> None:
        self._arrays = vertices.contiguous(), faces.to(torch.int32).contiguous().view(-1)
        with on_stream(vertices.device):
            points, indices = wp.from_torch(self._arrays[0], wp.vec3), wp.from_torch(self._arrays[1])
            self._mesh = wp.Mesh(points, indices)  # made once: the best tree, which the host builds, pays

    def closest(self, origin: torch.Tensor, direction: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor, torch.Tensor]:
        """Triangle (int32), -1 for none, u and v in it, distance, (R,) each, for rays (R, 3)."""
        triangle = torch.empty(len(origin), dtype=torch.int32, device=origin.device)
        u, v, distance = torch.empty(3, len(origin), device=origin.device)
        if len(origin):
            launch(closest, len(origin), self._mesh.id, origin.contiguous(), direction.contiguous(), triangle, u, v, distance)
        return triangle, u, v, distance

    def meet(self, origin: torch.Tensor, direction: torch.Tensor) -> torch.Tensor:
        """(R,) whether rays (R, 3) meet anything."""
        return self.closest(origin, direction)[0] >= 0
