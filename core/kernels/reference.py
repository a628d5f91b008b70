# SPDX-License-Identifier: GPL-3.0-or-later
"""The rasteriser's and the ray tracer's plain twins: brute force in float64 torch, with autograd. The oracle of the tests; slow."""

from __future__ import annotations

import torch

from ..datasets.camera import Camera
from . import harmonics as sh_constants
from .frame import COSINE_MIN
from .projection import ALPHA_MIN, LOW_PASS, NEAR
from .raster import _W_MIN, ALPHA_MAX, TRANSMITTANCE_MIN
from .trace import GRAZING


def sh_basis(direction: torch.Tensor, degree: int) -> torch.Tensor:
    """(3, N) unit directions to ((degree + 1)^2, N) real spherical harmonics."""
    x, y, z = direction
    c2, c3 = sh_constants.C2, sh_constants.C3
    rows = [torch.full_like(x, sh_constants.C0), -sh_constants.C1 * y, sh_constants.C1 * z, -sh_constants.C1 * x]
    rows += [c2[0] * x * y, c2[1] * y * z, c2[2] * (2 * z * z - x * x - y * y), c2[3] * x * z, c2[4] * (x * x - y * y)]
    rows += [c3[0] * y * (3 * x * x - y * y), c3[1] * x * y * z, c3[2] * y * (4 * z * z - x * x - y * y)]
    rows += [c3[3] * z * (2 * z * z - 3 * x * x - 3 * y * y), c3[4] * x * (4 * z * z - x * x - y * y)]
    rows += [c3[5] * z * (x * x - y * y), c3[6] * x * (x * x - 3 * y * y)]
    return torch.stack(rows[: (degree + 1) ** 2])


def rotation_matrix(quaternion: torch.Tensor) -> torch.Tensor:
    """(4, N) w x y z of any length to (3, 3, N) rotations; columns are the tangents and the normal."""
    w, x, y, z = quaternion / quaternion.norm(dim=0)
    return torch.stack(
        [
            torch.stack([1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)]),
            torch.stack([2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)]),
            torch.stack([2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)]),
        ]
    )


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
    """`rasterize` by definition: every pixel against every Gaussian, in float64; same arguments, (8 + E, H, W)."""
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
    side = torch.where(nc > 0, 1.0, -1.0)
    nc = torch.where(nc * side > COSINE_MIN * c.norm(dim=0), nc, (side * COSINE_MIN * c.norm(dim=0)).detach())
    features = torch.cat([colour.clamp_min(0), -side * axes[:, 2], extra])

    j, i = torch.meshgrid(torch.arange(camera.width) + 0.5, torch.arange(camera.height) + 0.5, indexing="xy")
    rays = torch.stack([(j.reshape(-1) - camera.cx) / camera.fx, (i.reshape(-1) - camera.cy) / camera.fy]).to(dtype)
    rays = torch.cat([rays, torch.ones_like(rays[:1])])  # (3, P)
    # The ray d meets the plane at depth nc / (n.d); u and v are coordinates there along the tangents.
    slope = nc + normal[:, None].mul(rays[:, :, None] - (c / c[2])[:, None]).sum(0) * c[2]  # n.d c_z, (P, N)
    ahead = slope / nc > _W_MIN
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


def _weights(alpha):
    """Weights along dim 1 of alphas sorted front to back; nearly opaque counts as opaque: there they are divided by their sum."""
    through = torch.cumprod(1 - alpha, 1)
    before = torch.cat([torch.ones_like(through[:, :1]), through[:, :-1]], 1)
    weight = torch.where(before > TRANSMITTANCE_MIN, alpha * before, 0.0)
    total = weight.sum(1, keepdim=True)
    return torch.where((1 - total) <= TRANSMITTANCE_MIN, weight / total.clamp_min(0.5), weight)


def _composite(alpha, depth, features, key, camera):
    order = torch.argsort(key, stable=True)
    alpha, depth, features = alpha[:, order], depth[:, order], features[:, order]
    weight = _weights(alpha)
    planes = [weight @ features.T, (weight * depth).sum(1, keepdim=True), weight.sum(1, keepdim=True)]
    return torch.cat(planes, 1).T.reshape(-1, camera.height, camera.width)


def trace_reference(
    position: torch.Tensor,
    quaternion: torch.Tensor,
    log_scale: torch.Tensor,
    opacity: torch.Tensor,
    sh: torch.Tensor | None,
    extra: torch.Tensor,
    origin: torch.Tensor,
    direction: torch.Tensor,
    degree: int = 3,
) -> torch.Tensor:
    """`trace` by definition: every ray against every Gaussian, in float64; same arguments without the tree, (R, 8 + E)."""
    axes, scale, alpha0 = rotation_matrix(quaternion), log_scale.exp(), opacity.sigmoid()
    cosine = direction @ axes[:, 2]
    square = cosine**2 > GRAZING
    centre = position - origin[:, :, None]  # (R, 3, N)
    t = (centre * axes[:, 2]).sum(1) / torch.where(square, cosine, 1.0)
    hit = direction[:, :, None] * t[:, None] - centre
    rho = ((hit * axes[:, 0]).sum(1) / scale[0]) ** 2 + ((hit * axes[:, 1]).sum(1) / scale[1]) ** 2
    alpha = (alpha0 * torch.exp(-0.5 * rho)).clamp_max(ALPHA_MAX)
    alpha = torch.where(square & (t > 0) & (alpha >= ALPHA_MIN), alpha, 0.0)
    order = torch.argsort(t, dim=1, stable=True)
    weight = torch.zeros_like(alpha).scatter(1, order, _weights(alpha.gather(1, order)))

    colour = torch.zeros(len(origin), 3, dtype=weight.dtype)
    if sh is not None:
        shown = torch.einsum("kr,kcn->rcn", sh_basis(direction.T, degree), sh[: (degree + 1) ** 2]) + 0.5
        colour = (shown.clamp_min(0) * weight[:, None]).sum(2)
    normal = torch.where(cosine > 0, -weight, weight) @ axes[:, 2].T
    parts = [colour, normal, weight @ extra.T, (weight * t).sum(1, keepdim=True), weight.sum(1, keepdim=True)]
    return torch.cat(parts, 1)
