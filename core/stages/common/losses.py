# SPDX-License-Identifier: GPL-3.0-or-later
"""The first stage's losses beside the photometric one."""

from __future__ import annotations

import torch

from ...scene.camera import Camera


def camera_rays(camera: Camera) -> torch.Tensor:
    """(3, H, W) float32 rays in OpenCV's camera axes, z = 1: depth times ray is the point."""
    x = (torch.arange(camera.width) + 0.5 - camera.cx) / camera.fx
    y = (torch.arange(camera.height) + 0.5 - camera.cy) / camera.fy
    y, x = torch.meshgrid(y, x, indexing="ij")
    return torch.stack([x, y, torch.ones_like(x)]).float()


def depth_normals(depth: torch.Tensor, rays: torch.Tensor) -> torch.Tensor:
    """(3, H-2, W-2) unit normals, camera axes, towards the camera, by central differences of the points depth (H, W) x rays (3, H, W)."""
    points = rays * depth
    dx = points[:, 1:-1, 2:] - points[:, 1:-1, :-2]
    dy = points[:, 2:, 1:-1] - points[:, :-2, 1:-1]
    normal = torch.linalg.cross(dy, dx, dim=0)
    return normal * torch.rsqrt(normal.square().sum(0, keepdim=True).clamp_min(1e-20))


def normal_consistency(image: torch.Tensor, rays: torch.Tensor, rotation: torch.Tensor) -> torch.Tensor:
    """Mean over pixels of alpha (1 - n_splat . n_depth), the outer alpha detached (2DGS, eq. 14).

    Args:
        image: (C, H, W) of `rasterize`: normals in channels 3..6, depth and opacity last. rays: `camera_rays`.
        rotation: (3, 3) world to camera (OpenCV axes).
    """
    alpha = image[-1]
    # Not detached here: sum(w z) / sum(w) must not look deeper when a splat only grows more opaque.
    surface = depth_normals(image[-2] / alpha.clamp_min(1e-3), rays)
    splat = torch.einsum("ij,jhw->ihw", rotation, image[3:6, 1:-1, 1:-1])
    weight = alpha.detach()[1:-1, 1:-1]
    return (weight - (splat * surface).sum(0)).sum() / alpha.numel()
