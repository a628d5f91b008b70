# SPDX-License-Identifier: GPL-3.0-or-later
"""Closest hits of rays on triangles by Warp's mesh; called by core/relight/mesh_tracer.py."""

import torch
import warp as wp

from .runtime import launch, on_stream

_FAR = wp.constant(3.0e38)


@wp.kernel
def closest(
    mesh: wp.uint64, origin: wp.array(dtype=wp.vec3), direction: wp.array(dtype=wp.vec3), triangle: wp.array(dtype=int),
    u: wp.array(dtype=float), v: wp.array(dtype=float), distance: wp.array(dtype=float),
):  # fmt: skip
    """Find the nearest triangle of each ray, (R,), -1 for none; u and v are the barycentric weights of its second and third corner."""
    ray = wp.tid()
    hit = wp.mesh_query_ray(mesh, origin[ray], direction[ray], _FAR)
    triangle[ray] = -1
    if hit.result:
        triangle[ray] = hit.face
        u[ray] = hit.v
        v[ray] = 1.0 - hit.u - hit.v
        distance[ray] = hit.t


@wp.kernel
def blocked(
    mesh: wp.uint64, origin: wp.array(dtype=wp.vec3), direction: wp.array(dtype=wp.vec3), reach: wp.array(dtype=float),
    met: wp.array(dtype=wp.bool),
):  # fmt: skip
    """Test whether each ray, (R,), meets a triangle nearer than its reach; a reach of no elements: at any distance."""
    ray = wp.tid()
    far = float(_FAR)
    if reach.shape[0] > 0:
        far = reach[ray]
    met[ray] = wp.mesh_query_ray_anyhit(mesh, origin[ray], direction[ray], far)


class DeviceMesh:
    """Triangle mesh for ray queries on the GPU.

    Args:
        vertices: (V, 3) float32, on the device.
        faces: (F, 3) indices of vertices, on the device.
    """

    def __init__(self, vertices: torch.Tensor, faces: torch.Tensor) -> None:
        self._arrays = vertices.contiguous(), faces.to(torch.int32).contiguous().view(-1)
        with on_stream(vertices.device):
            points, indices = wp.from_torch(self._arrays[0], wp.vec3), wp.from_torch(self._arrays[1])
            self._mesh = wp.Mesh(points, indices, bvh_constructor="sah")  # built once: the best tree, built on the host, pays off

    def closest(self, origin: torch.Tensor, direction: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor, torch.Tensor]:
        """Find the nearest hit of each ray.

        Args:
            origin: (R, 3) ray origins, world.
            direction: (R, 3) unit directions.

        Returns:
            (R,) each: triangle (int32), -1 for none; u and v in it; distance.
        """
        triangle = torch.empty(len(origin), dtype=torch.int32, device=origin.device)
        u, v, distance = torch.empty(3, len(origin), device=origin.device)
        if len(origin):
            launch(closest, len(origin), self._mesh.id, origin.contiguous(), direction.contiguous(), triangle, u, v, distance)
        return triangle, u, v, distance

    def meet(self, origin: torch.Tensor, direction: torch.Tensor, reach: torch.Tensor | None = None) -> torch.Tensor:
        """Test rays for any hit.

        Args:
            origin: (R, 3) ray origins, world.
            direction: (R, 3) unit directions.
            reach: (R,) distances up to which triangles count; None: any distance.

        Returns:
            (R,) bool, True for rays that hit the mesh.
        """
        met = torch.empty(len(origin), dtype=torch.bool, device=origin.device)
        ends = origin.new_empty(0) if reach is None else reach.contiguous()
        if len(origin):
            launch(blocked, len(origin), self._mesh.id, origin.contiguous(), direction.contiguous(), ends, met)
        return met
