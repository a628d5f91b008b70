# SPDX-License-Identifier: GPL-3.0-or-later
"""Ray tracing of a triangle mesh: Embree on the CPU, Warp on a GPU."""

from __future__ import annotations

from typing import Protocol

import numpy as np
import torch

from ..machine.backend import by_warp
from ..machine.thread_pool import even_ranges, run_ranges, thread_count
from ..scene.mesh import Mesh
from ..scene.triangle_tracer import TriangleTracer

MIN_SHADOW_RAYS = 1 << 13  # of a range: fewer are traced sooner by one thread than handed to another
FAR = 1e37  # distance that counts as infinite, as in Embree's wrapper


class MeshTracer(Protocol):
    """Tracer of rays on a triangle mesh."""

    def closest(self, origin: torch.Tensor, direction: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor, torch.Tensor]:
        """Find the first triangle that each ray meets.

        Args:
            origin: (R, 3) world, float32.
            direction: (R, 3) unit, float32.

        Returns:
            Triangle index (int32), -1 for none, barycentric weights of its second and third corner, and distance, (R,) each.
        """
        ...

    def meet(self, origin: torch.Tensor, direction: torch.Tensor, reach: torch.Tensor | None = None) -> torch.Tensor:
        """Return True for rays that meet any triangle, (R,).

        Args:
            origin: (R, 3) world, float32.
            direction: (R, 3) unit, float32.
            reach: (R,) distances up to which triangles count, float32; None: any distance.
        """
        ...


def mesh_tracer(mesh: Mesh, device: torch.device | str) -> MeshTracer:
    """Build the acceleration structure of a mesh.

    Args:
        mesh: the mesh.
        device: device that rays come from.
    """
    vertices = torch.from_numpy(np.ascontiguousarray(mesh.vertices, np.float32)).to(device)
    if not by_warp(vertices):
        return EmbreeTracer(mesh)
    from ..kernels.warp.mesh import DeviceMesh  # an optional dependency

    return DeviceMesh(vertices, torch.from_numpy(mesh.faces).to(device))


class EmbreeTracer:
    """`MeshTracer` by Embree on the CPU.

    Args:
        mesh: the mesh.
    """

    def __init__(self, mesh: Mesh) -> None:
        self._tracer = TriangleTracer(mesh.vertices[mesh.faces])

    def closest(self, origin: torch.Tensor, direction: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor, torch.Tensor]:
        """Find the first triangle that each ray meets.

        Args:
            origin: see `MeshTracer.closest`, also for the result.
            direction: likewise.
        """
        origins, directions = origin.contiguous().numpy(), direction.contiguous().numpy()
        triangle = np.empty(len(origins), np.int32)
        u, v, distance = np.empty((3, len(origins)), np.float32)

        def run(begin: int, end: int) -> None:
            found = self._tracer.closest(origins[begin:end], directions[begin:end])
            for array, values in zip((triangle, u, v, distance), found, strict=True):
                array[begin:end] = values

        run_ranges(run, even_ranges(len(origins), thread_count()))
        return torch.from_numpy(triangle), torch.from_numpy(u), torch.from_numpy(v), torch.from_numpy(distance)

    def meet(self, origin: torch.Tensor, direction: torch.Tensor, reach: torch.Tensor | None = None) -> torch.Tensor:
        """Return True for rays that meet any triangle.

        Args:
            origin: see `MeshTracer.meet`, also for the result.
            direction: likewise.
            reach: likewise.
        """
        origins, directions = origin.contiguous().numpy(), direction.contiguous().numpy()
        occluded = np.empty(len(origins), bool)
        far = None if reach is None else reach.clamp_max(FAR).contiguous().numpy()

        def run(begin: int, end: int) -> None:
            ends = None if far is None else far[begin:end]
            occluded[begin:end] = self._tracer.meet(origins[begin:end], directions[begin:end], ends)

        run_ranges(run, even_ranges(len(origins), min(thread_count(), max(1, len(origins) // MIN_SHADOW_RAYS))))
        return torch.from_numpy(occluded)
