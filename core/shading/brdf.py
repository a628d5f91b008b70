# SPDX-License-Identifier: GPL-3.0-or-later
"""The microfacet BRDF: GGX, height-correlated Smith, Schlick; alpha = roughness^2. The only one in the project.

f = (1 - m) a / pi + F D V,  F0 = 0.04 (1 - m) + m a,  V = G / (4 n.l n.v)
"""

from __future__ import annotations

import math

import torch

DIELECTRIC_F0 = 0.04
ALPHA_FLOOR = 0.05**2  # roughness below 0.05 is treated as 0.05
COSINE_FLOOR = 1e-3  # of n.v: at silhouettes an averaged normal may look away from the camera


def ggx_alpha(roughness: torch.Tensor) -> torch.Tensor:
    """Perceptual roughness in 0..1 to GGX alpha, floored."""
    return (roughness * roughness).clamp_min(ALPHA_FLOOR)


def ggx_distribution(n_h: torch.Tensor, alpha: torch.Tensor) -> torch.Tensor:
    """D: density of microfacet normals per unit projected area (Walter 2007, eq. 33); n_h = cosine to the half vector."""
    return ggx_of_sine(1 - n_h * n_h, alpha)


def ggx_of_sine(sine2: torch.Tensor, alpha: torch.Tensor) -> torch.Tensor:
    """D from the squared sine between normal and half vector: in float32 a cosine near 1 says too little of a sharp lobe."""
    a2 = alpha * alpha
    return a2 / (math.pi * (a2 + sine2 * (1 - a2)) ** 2)


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


def facing(view: torch.Tensor, normal: torch.Tensor) -> torch.Tensor:
    """(P, 3) unit view, bent towards the unit normal where n.v is below COSINE_FLOOR. Sampling and shading both use it."""
    short = (COSINE_FLOOR - (view * normal).sum(-1, keepdim=True)).clamp_min(0)
    return torch.nn.functional.normalize(view + short * normal, dim=-1)


def specular_lobe(
    view: torch.Tensor, normal: torch.Tensor, alpha: torch.Tensor, direction: torch.Tensor
) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
    """The specular BRDF without its colour, for N directions at each of P points.

    Args:
        view: (P, 3) unit, n.v > 0. normal: (P, 3) unit. alpha: (P,). direction: (P, N, 3) unit.

    Returns:
        (P, N) each: n.l; D V, zero where n.l <= 0; Schlick's (1 - v.h)^5.  F D V = (F0 + (1 - F0) power) D V.
    """
    alpha = alpha[:, None]
    n_l = torch.einsum("pnc,pc->pn", direction, normal)
    n_v = (view * normal).sum(-1)[:, None]
    half = direction + view[:, None]  # not of unit length
    length2 = (half * half).sum(-1).clamp_min(1e-7)
    aside = half - (n_l + n_v)[..., None] * normal[:, None]
    above = n_l > 0
    cosine = torch.where(above, n_l, 1.0)
    value = ggx_of_sine((aside * aside).sum(-1) / length2, alpha) * smith_visibility(cosine, n_v, alpha)
    power = (1 - 0.5 * length2.sqrt()).clamp(0, 1) ** 5  # |half| = 2 v.h
    return n_l, torch.where(above, value, 0.0), power


def visible_normal_density(view: torch.Tensor, direction: torch.Tensor, alpha: torch.Tensor) -> torch.Tensor:
    """Density per steradian of directions mirrored at `sample_visible_normal`: G1(v) D(h) / (4 n.v), in the local frame.

    view: (..., 3), direction: (..., 3) unit; alpha: (...). Zero where the half vector points below the surface.
    """
    half = view + direction
    up, n_v = half[..., 2], view[..., 2]
    flat2 = half[..., 0] ** 2 + half[..., 1] ** 2
    a2 = alpha * alpha
    masked = 0.5 / (n_v + (a2 + (1 - a2) * n_v * n_v).sqrt())  # G1 / (4 n.v) without a division by n.v
    return torch.where(up > 0, ggx_of_sine(flat2 / (flat2 + up * up).clamp_min(1e-14), alpha) * masked, 0.0)


def sample_visible_normal(view: torch.Tensor, alpha: torch.Tensor, u: torch.Tensor) -> torch.Tensor:
    """Half vectors seen from `view` by spherical caps (Dupuy and Benyoub 2023), in the local frame with the normal along +z.

    Args:
        view: (..., 3) unit, z > 0. alpha: (...). u: (..., 2) uniform in [0, 1).

    Returns:
        (..., 3) unit, density G1(v) D(h) max(v.h, 0) / v.z.
    """
    a = alpha[..., None]
    v = torch.nn.functional.normalize(torch.cat([view[..., :2] * a, view[..., 2:]], -1), dim=-1)
    z = (1 - u[..., 0]) * (1 + v[..., 2]) - v[..., 2]
    r, phi = (1 - z * z).clamp_min(0).sqrt(), 2 * math.pi * u[..., 1]
    h = torch.stack([r * phi.cos(), r * phi.sin(), z], -1) + v
    return torch.nn.functional.normalize(torch.cat([h[..., :2] * a, h[..., 2:].clamp_min(1e-6)], -1), dim=-1)
