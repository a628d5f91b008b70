# SPDX-License-Identifier: GPL-3.0-or-later
"""Losses next to the photometric one: normal consistency and smoothness of the light map."""

from __future__ import annotations

import torch

from ...scene.camera import Camera


def camera_rays(camera: Camera) -> torch.Tensor:
    """Return (3, H, W) float32 rays through the pixel centres in OpenCV's camera axes with z = 1: planar depth times ray is the point."""
    x = (torch.arange(camera.width) + 0.5 - camera.cx) / camera.fx
    y = (torch.arange(camera.height) + 0.5 - camera.cy) / camera.fy
    y, x = torch.meshgrid(y, x, indexing="ij")
    return torch.stack([x, y, torch.ones_like(x)]).float()


def depth_normals(depth: torch.Tensor, rays: torch.Tensor) -> torch.Tensor:
    """Compute normals of a depth map by central differences of the back-projected points.

    Args:
        depth: (H, W) planar depth.
        rays: (3, H, W) as of `camera_rays`.

    Returns:
        (3, H-2, W-2) unit normals in camera axes, facing the camera, without the border pixels.
    """
    points = rays * depth
    dx = points[:, 1:-1, 2:] - points[:, 1:-1, :-2]
    dy = points[:, 2:, 1:-1] - points[:, :-2, 1:-1]
    normal = torch.linalg.cross(dy, dx, dim=0)
    return normal * torch.rsqrt(normal.square().sum(0, keepdim=True).clamp_min(1e-20))


def normal_consistency(image: torch.Tensor, rays: torch.Tensor, rotation: torch.Tensor) -> torch.Tensor:
    """Compute the normal consistency loss of 2DGS (Huang et al. 2024, eq. 14): mean over pixels of alpha (1 - n_splat . n_depth).

    Args:
        image: (C, H, W) of `rasterize`: normals in channels 3..6, depth and opacity last; not divided by opacity.
        rays: (3, H, W) as of `camera_rays`.
        rotation: (3, 3) world to camera (OpenCV axes).

    Returns:
        Scalar; the outer alpha is detached.
    """
    alpha = image[-1]
    # Not detached here: sum(w z) / sum(w) must not increase the depth when a splat only grows more opaque.
    surface = depth_normals(image[-2] / alpha.clamp_min(1e-3), rays)
    splat = torch.einsum("ij,jhw->ihw", rotation, image[3:6, 1:-1, 1:-1])
    weight = alpha.detach()[1:-1, 1:-1]
    return (weight - (splat * surface).sum(0)).sum() / alpha.numel()


def light_variation(log_light: torch.Tensor) -> torch.Tensor:
    """Return the mean squared difference of neighbouring texels of a lat-long map (H, W, 3) of log radiance, which wraps around in W."""
    across = log_light - torch.roll(log_light, 1, 1)
    return across.square().mean() + (log_light[1:] - log_light[:-1]).square().mean()
