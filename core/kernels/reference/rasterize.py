# SPDX-License-Identifier: GPL-3.0-or-later
"""Float64 reference of the rasteriser of 2D Gaussians: every pixel against every Gaussian."""

from __future__ import annotations

import torch

from ...scene.camera import Camera
from ...scene.spherical_harmonics import sh_basis
from ..constants import ALPHA_MAX, ALPHA_MIN, BEHIND, COSINE_MIN, HORIZON_MIN, LOW_PASS, NEAR
from .compositing import weights
from .rotations import rotation_matrix


def rasterize_reference(
    position: torch.Tensor,
    quaternion: torch.Tensor,
    log_scale: torch.Tensor,
    opacity: torch.Tensor,
    sh: torch.Tensor,
    extra: torch.Tensor,
    camera: Camera,
    scene_radius: float,
    degree: int = 3,
) -> torch.Tensor:
    """Composite 2D Gaussians by definition, every pixel against every Gaussian, in float64.

    Args:
        position: (3, N) centres, world.
        quaternion: (4, N) w x y z of any length.
        log_scale: (2, N) logarithms of the two scales.
        opacity: (N,) logits.
        sh: (K, 3, N) SH coefficients, K >= (degree + 1)^2.
        extra: (E, N) further channels.
        camera: camera of the image, H x W pixels.
        scene_radius: radius of the scene, world units; it sets the near plane.
        degree: SH degree in use, 0..3.

    Returns:
        (8 + E, H, W) image, channels as in `core.kernels.rasterize.rasterize`.
    """
    dtype = torch.float64
    to_camera = torch.as_tensor(camera.world_to_cv[:3, :3], dtype=dtype)
    eye = torch.as_tensor(camera.centre, dtype=dtype)
    offset = position - eye[:, None]
    c = to_camera @ offset
    axes = rotation_matrix(quaternion)
    tu, tv, normal = (to_camera @ axes[:, j] for j in range(3))
    scale, alpha0 = log_scale.exp(), opacity.sigmoid()

    colour = (sh_basis(offset / offset.norm(dim=0), degree)[:, None] * sh[: (degree + 1) ** 2]).sum(0) + 0.5
    nc = (normal * c).sum(0)
    distance, side = c.norm(dim=0), torch.where(nc > 0, 1.0, -1.0)
    facing = torch.where(nc > BEHIND * distance, -1.0, 1.0)
    nc = torch.where(nc * side > COSINE_MIN * distance, nc, (side * COSINE_MIN * distance).detach())
    features = torch.cat([colour.clamp_min(0), facing * axes[:, 2], extra])

    j, i = torch.meshgrid(torch.arange(camera.width) + 0.5, torch.arange(camera.height) + 0.5, indexing="xy")
    rays = torch.stack([(j.reshape(-1) - camera.cx) / camera.fx, (i.reshape(-1) - camera.cy) / camera.fy]).to(dtype)
    rays = torch.cat([rays, torch.ones_like(rays[:1])])  # (3, P)
    # The ray d meets the plane at depth nc / (n.d); u and v are coordinates there along the tangents.
    slope = nc + normal[:, None].mul(rays[:, :, None] - (c / c[2])[:, None]).sum(0) * c[2]  # n.d c_z, (P, N)
    ahead = slope / nc > HORIZON_MIN
    t = torch.where(ahead, nc * c[2] / torch.where(ahead, slope, 1.0), 0.0)
    hit = rays[:, :, None] * t  # (3, P, N)
    u = (hit * tu[:, None]).sum(0) - (c * tu).sum(0)
    v = (hit * tv[:, None]).sum(0) - (c * tv).sum(0)
    rho = torch.where(ahead, (u / scale[0]) ** 2 + (v / scale[1]) ** 2, 1e9)
    dx = (rays[0][:, None] - c[0] / c[2]) * camera.fx
    dy = (rays[1][:, None] - c[1] / c[2]) * camera.fy
    flat = LOW_PASS * (dx**2 + dy**2)
    filtered = rho > flat
    alpha = (alpha0 * torch.exp(-0.5 * torch.minimum(rho, flat))).clamp_max(ALPHA_MAX)
    seen = (c[2] > NEAR * scene_radius) & (alpha >= ALPHA_MIN)
    return _composite(torch.where(seen, alpha, 0.0), torch.where(filtered, c[2], t), features, c[2], camera)


def _composite(alpha, depth, features, key, camera):
    """Composite alpha and depth (P, N), features (F, N), sorted by `key` (N,), into an image (F + 2, H, W)."""
    order = torch.argsort(key, stable=True)
    alpha, depth, features = alpha[:, order], depth[:, order], features[:, order]
    weight = weights(alpha)
    planes = [weight @ features.T, (weight * depth).sum(1, keepdim=True), weight.sum(1, keepdim=True)]
    return torch.cat(planes, 1).T.reshape(-1, camera.height, camera.width)
