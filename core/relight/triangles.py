# SPDX-License-Identifier: GPL-3.0-or-later
"""Rays on the triangles of a mesh: Embree's closest hit on the CPU, warp's on a device."""

from __future__ import annotations

from typing import Protocol

import numpy as np
import torch
from embreex.mesh_construction import TriangleMesh
from embreex.rtcore_scene import EmbreeScene

from ..machine.backend import by_warp
from ..machine.thread_pool import even_ranges, run_ranges, thread_count
from ..scene.mesh import Mesh


class Triangles(Protocol):
    """A mesh that rays can be asked about."""

    def closest(self, origin: torch.Tensor, direction: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor, torch.Tensor]:
        """What rays (R, 3) meet first: triangle (int32), -1 for none, the shares of its second and third corner, distance."""
        ...

    def meet(self, origin: torch.Tensor, direction: torch.Tensor) -> torch.Tensor:
        """(R,) whether rays (R, 3) meet anything."""
        ...


def triangles_of(mesh: Mesh, device: torch.device | str) -> Triangles:
    """A mesh for rays that come from a device."""
    vertices = torch.from_numpy(np.ascontiguousarray(mesh.vertices, np.float32)).to(device)
    if not by_warp(vertices):
        return EmbreeTriangles(mesh)
    from ..kernels.warp.mesh import DeviceMesh  # an option, not installed everywhere

    return DeviceMesh(vertices, torch.from_numpy(mesh.faces).to(device))


class EmbreeTriangles:
    """`Triangles` by Embree."""

    def __init__(self, mesh: Mesh) -> None:
        self._scene = EmbreeScene()
        TriangleMesh(self._scene, np.ascontiguousarray(mesh.vertices[mesh.faces], np.float32))
        # The first query commits the scene, which threads must not race for.
        self._scene.run(np.zeros((1, 3), np.float32), np.array([[0, 0, 1]], np.float32))

    def closest(self, origin: torch.Tensor, direction: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor, torch.Tensor]:
        """See `Triangles`."""
        origins, directions = origin.contiguous().numpy(), direction.contiguous().numpy()
        triangle = np.empty(len(origins), np.int32)
        u, v, distance = np.empty((3, len(origins)), np.float32)

        def run(begin: int, end: int) -> None:
            found = self._scene.run(origins[begin:end], directions[begin:end], query="INTERSECT", output=True)
            for to, name in ((triangle, "primID"), (u, "u"), (v, "v"), (distance, "tfar")):
                to[begin:end] = found[name]

        run_ranges(run, even_ranges(len(origins), thread_count()))
        return torch.from_numpy(triangle), torch.from_numpy(u), torch.from_numpy(v), torch.from_numpy(distance)

    def meet(self, origin: torch.Tensor, direction: torch.Tensor) -> torch.Tensor:
        """See `Triangles`."""
        origins, directions = origin.contiguous().numpy(), direction.contiguous().numpy()
        met = np.empty(len(origins), bool)

        def run(begin: int, end: int) -> None:
            met[begin:end] = self._scene.run(origins[begin:end], directions[begin:end], query="OCCLUDED") >= 0

        run_ranges(run, even_ranges(len(origins), thread_count()))
        return torch.from_numpy(met)
