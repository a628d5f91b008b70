# SPDX-License-Identifier: GPL-3.0-or-later
"""Normals of the extracted mesh as a camera sees them."""

from __future__ import annotations

import numpy as np
import torch

from ..relight.mesh_query import MeshQuery
from ..scene.camera import Camera


def mesh_normals(mesh: MeshQuery, camera: Camera) -> tuple[np.ndarray, np.ndarray]:
    """Trace one ray through each pixel's centre.

    Args:
        mesh: extracted mesh.
        camera: of H x W pixels.

    Returns:
        (H, W, 3) unit normals in the world, 0 where no mesh is, and (H, W) 1 where the mesh is, else 0.
    """
    rays = camera.rays().reshape(-1, 3).astype(np.float32)
    direction = torch.nn.functional.normalize(torch.from_numpy(rays), dim=1).to(mesh.device)
    origin = torch.as_tensor(camera.centre, dtype=torch.float32, device=mesh.device).expand_as(direction).contiguous()
    hits = mesh.hits(origin, direction)
    normal, covered = torch.zeros_like(direction), direction.new_zeros(len(direction))
    normal[hits.ray], covered[hits.ray] = hits.normal, 1.0
    shape = camera.height, camera.width
    return normal.cpu().numpy().reshape(*shape, 3), covered.cpu().numpy().reshape(shape)
