# SPDX-License-Identifier: GPL-3.0-or-later
"""The microfacet BRDF: GGX, height-correlated Smith, Schlick; alpha = roughness^2. The only one in the project.

f = (1 - m) a / pi + F D V,  F0 = 0.04 (1 - m) + m a,  V = G / (4 n.l n.v)
"""

from __future__ import annotations

import math

import torch

DIELECTRIC_F0 = 0.04
ALPHA_FLOOR = 0.05**2  # roughness below 0.05 is treated as 0.05


def ggx_alpha(roughness: torch.Tensor) -> torch.Tensor:
    """Perceptual roughness in 0..1 to GGX alpha, floored."""
    return (roughness * roughness).clamp_min(ALPHA_FLOOR)


def ggx_distribution(n_h: torch.Tensor, alpha: torch.Tensor) -> torch.Tensor:
    """D: density of microfacet normals per unit projected area (Walter 2007, eq. 33); n_h = cosine to the half vector."""
    a2 = alpha * alpha
    return a2 / (math.pi * ((n_h * n_h) * (a2 - 1) + 1) ** 2)


def smith_visibility(n_l: torch.Tensor, n_v: torch.Tensor, alpha: torch.Tensor) -> torch.Tensor:
    """V = G / (4 n.l n.v), height-correlated Smith (Heitz 2014, eq. 99); written so that nothing overflows at grazing angles."""
    a2 = alpha * alpha
    lambda_v = n_l * torch.sqrt(n_v * n_v * (1 - a2) + a2)
    lambda_l = n_v * torch.sqrt(n_l * n_l * (1 - a2) + a2)
    return 0.5 / (lambda_v + lambda_l).clamp_min(1e-7)


def schlick(v_h: torch.Tensor, f0: torch.Tensor) -> torch.Tensor:
    """Fresnel reflectance at cosine v_h (Schlick 1994)."""
    return f0 + (1 - f0) * (1 - v_h).clamp(0, 1) ** 5


def base_reflectance(albedo: torch.Tensor, metallic: torch.Tensor) -> torch.Tensor:
    """F0 = 0.04 (1 - m) + m a; albedo (..., 3), metallic (..., 1)."""
    return DIELECTRIC_F0 * (1 - metallic) + metallic * albedo


def sample_visible_normal(view: torch.Tensor, alpha: torch.Tensor, u: torch.Tensor) -> torch.Tensor:
    """Half vectors seen from `view` (Heitz 2018), in the local frame with the normal along +z.

    Args:
        view: (..., 3) unit, z > 0. alpha: (...). u: (..., 2) uniform in [0, 1).

    Returns:
        (..., 3) unit, density G1(v) D(h) max(v.h, 0) / v.z.
    """
    a = alpha[..., None]
    v = torch.nn.functional.normalize(torch.cat([view[..., :2] * a, view[..., 2:]], -1), dim=-1)
    length = v[..., 0] ** 2 + v[..., 1] ** 2
    flat = torch.stack([-v[..., 1], v[..., 0], torch.zeros_like(length)], -1) / length.clamp_min(1e-20).sqrt()[..., None]
    t1 = torch.where((length > 1e-12)[..., None], flat, torch.tensor([1.0, 0.0, 0.0], dtype=v.dtype, device=v.device))
    t2 = torch.linalg.cross(v, t1)
    r, phi = u[..., 0].sqrt(), 2 * math.pi * u[..., 1]
    p1, p2 = r * phi.cos(), r * phi.sin()
    s = 0.5 * (1 + v[..., 2])
    p2 = (1 - s) * (1 - p1 * p1).clamp_min(0).sqrt() + s * p2
    p3 = (1 - p1 * p1 - p2 * p2).clamp_min(0).sqrt()
    h = p1[..., None] * t1 + p2[..., None] * t2 + p3[..., None] * v
    return torch.nn.functional.normalize(torch.cat([h[..., :2] * a, h[..., 2:].clamp_min(1e-6)], -1), dim=-1)
