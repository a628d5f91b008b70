# SPDX-License-Identifier: GPL-3.0-or-later
"""Secondary rays on the mesh: Embree's closest hit, vertex materials interpolated."""

from __future__ import annotations

import numpy as np
import torch
from embreex.mesh_construction import TriangleMesh
from embreex.rtcore_scene import EmbreeScene

from ..kernels.pool import even_ranges, run_ranges, thread_count
from ..scene.mesh import Mesh
from .query import Hits

OFFSET = 0.012  # of the scene radius: rays start above points of the Gaussians' surface, which is not exactly the mesh's


class MeshQuery:
    """A mesh as `SurfaceQuery`: a ray meets it or it does not.

    Args:
        mesh: the mesh. radius: of the scene, which lengths are measured by.
    """

    def __init__(self, mesh: Mesh, radius: float) -> None:
        self._faces, self._offset = torch.from_numpy(mesh.faces.astype(np.int64)), OFFSET * radius
        rows = (mesh.normals, mesh.albedo, mesh.roughness[:, None], mesh.metallic[:, None])
        self._attributes = torch.from_numpy(np.concatenate(rows, 1, dtype=np.float32))
        self._scene = EmbreeScene()
        TriangleMesh(self._scene, np.ascontiguousarray(mesh.vertices[mesh.faces], np.float32))
        # The first query commits the scene, which threads must not race for.
        self._scene.run(np.zeros((1, 3), np.float32), np.array([[0, 0, 1]], np.float32))

    def origins(self, point: torch.Tensor, normal: torch.Tensor) -> torch.Tensor:
        """See `SurfaceQuery`."""
        return point + self._offset * normal

    def hits(self, origin: torch.Tensor, direction: torch.Tensor) -> Hits:
        """See `SurfaceQuery`."""
        origins, directions = origin.contiguous().numpy(), direction.contiguous().numpy()
        triangle = np.empty(len(origins), np.int32)
        uv = np.empty((2, len(origins)), np.float32)

        def run(begin: int, end: int) -> None:
            found = self._scene.run(origins[begin:end], directions[begin:end], query="INTERSECT", output=True)
            triangle[begin:end], uv[0, begin:end], uv[1, begin:end] = found["primID"], found["u"], found["v"]

        run_ranges(run, even_ranges(len(origins), thread_count()))
        ray = np.flatnonzero(triangle >= 0)
        return self._hits(torch.from_numpy(ray), torch.from_numpy(triangle[ray]), torch.from_numpy(uv[:, ray]), direction)

    def _hits(self, ray: torch.Tensor, triangle: torch.Tensor, uv: torch.Tensor, direction: torch.Tensor) -> Hits:
        corners = self._attributes[self._faces[triangle]]  # (K, 3, 8)
        share = torch.stack([1 - uv[0] - uv[1], uv[0], uv[1]], 1)
        at = torch.einsum("kc,kca->ka", share, corners)
        normal = torch.nn.functional.normalize(at[:, :3], dim=1)
        away = (normal * direction[ray]).sum(1, keepdim=True) > 0
        materials = (at[:, 3:6], at[:, 6].contiguous(), at[:, 7])
        return Hits(ray, torch.ones(len(ray)), *materials, torch.where(away, -normal, normal))
