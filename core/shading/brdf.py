# SPDX-License-Identifier: GPL-3.0-or-later
"""Microfacet BRDFs: that of the whole project ("principled"), and that of the baseline IRGS ("irgs").

principled: GGX distribution, height-correlated Smith masking-shadowing, Fresnel's equations for an index of refraction of
1.5, as in Blender's Principled BSDF (`constants.FRESNEL`).
f = (1 - m) a / pi + F D V,  F0 = 0.04 (1 - m) + m a,  V = G / (4 n.l n.v),  alpha = roughness^2
irgs: no metal. f = a / pi + F alpha^2 / clamp(4 pi ((n.h)^2 (alpha^2 - 1) + 1)^2 g(n.v) g(n.l), 1e-6, 4 pi), F0 = 0.04,
g(x) = x (1 - k) + k with k = (roughness + 1)^2 / 8 (Schlick's masking)
"""

from __future__ import annotations

import math

import torch

from ..kernels.constants import COSINE_FLOOR, DIELECTRIC_F0, FRESNEL, IRGS_DENOMINATOR, IRGS_FRESNEL, LEAST_ALPHA


def ggx_alpha(roughness: torch.Tensor) -> torch.Tensor:
    """Return the GGX alpha, roughness^2 with a lower bound, for perceptual roughness (...,) in 0..1."""
    return (roughness * roughness).clamp_min(LEAST_ALPHA)


def ggx_distribution(n_h: torch.Tensor, alpha: torch.Tensor) -> torch.Tensor:
    """Return D, the density of microfacet normals per unit projected area (Walter 2007, eq. 33).

    Args:
        n_h: (...,) cosine between normal and half vector.
        alpha: (...,) of GGX, broadcast against `n_h`.
    """
    return ggx_of_sine(1 - n_h * n_h, alpha)


def ggx_of_sine(sine2: torch.Tensor, alpha: torch.Tensor) -> torch.Tensor:
    """Return D from a sine instead of a cosine: in float32 a cosine near 1 is too inaccurate for a sharp lobe.

    Args:
        sine2: (...,) squared sine between normal and half vector.
        alpha: (...,) of GGX, broadcast against `sine2`.
    """
    a2 = alpha * alpha
    return a2 / (math.pi * (a2 + sine2 * (1 - a2)) ** 2)


def smith_visibility(n_l: torch.Tensor, n_v: torch.Tensor, alpha: torch.Tensor) -> torch.Tensor:
    """Return V = G / (4 n.l n.v), height-correlated Smith (Heitz 2014, eq. 99), in a form that does not overflow at grazing angles.

    Args:
        n_l: (...,) cosine between normal and light direction, >= 0.
        n_v: (...,) cosine between normal and view direction, >= 0.
        alpha: (...,) of GGX.
    """
    a2 = alpha * alpha
    lambda_v = n_l * torch.sqrt(n_v * n_v * (1 - a2) + a2)
    lambda_l = n_v * torch.sqrt(n_l * n_l * (1 - a2) + a2)
    return 0.5 / (lambda_v + lambda_l).clamp_min(1e-7)


def fresnel_weight(v_h: torch.Tensor) -> torch.Tensor:
    """Return w of the Fresnel reflectance F = F0 + (1 - F0) w; a metal takes the same w, which changes F by 1 % where F0 is 0.7 and more.

    Args:
        v_h: (...,) cosine between view direction and half vector.
    """
    x, polynomial = (1 - v_h).clamp(0, 1), 0.0
    for factor in reversed(FRESNEL):
        polynomial = polynomial * x + factor
    return x**3 * polynomial


def base_reflectance(albedo: torch.Tensor, metallic: torch.Tensor) -> torch.Tensor:
    """Return F0 = 0.04 (1 - m) + m a, (..., 3).

    Args:
        albedo: (..., 3) linear, 0..1.
        metallic: (..., 1) in 0..1.
    """
    return DIELECTRIC_F0 * (1 - metallic) + metallic * albedo


def bend_view_to_normal(view: torch.Tensor, normal: torch.Tensor) -> torch.Tensor:
    """Bend view directions towards the normal where n.v is below COSINE_FLOOR; sampling and shading both use the result.

    Args:
        view: (P, 3) unit, towards the eye.
        normal: (P, 3) unit.

    Returns:
        (P, 3) unit view directions.
    """
    short = (COSINE_FLOOR - (view * normal).sum(-1, keepdim=True)).clamp_min(0)
    return torch.nn.functional.normalize(view + short * normal, dim=-1)


def specular_lobe(
    view: torch.Tensor, normal: torch.Tensor, alpha: torch.Tensor, direction: torch.Tensor
) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
    """Evaluate the specular BRDF without its Fresnel colour, for N directions at each of P points.

    Args:
        view: (P, 3) unit, towards the eye, n.v > 0.
        normal: (P, 3) unit.
        alpha: (P,) of GGX.
        direction: (P, N, 3) unit, towards the light.

    Returns:
        Three (P, N) tensors: n.l; D V, zero where n.l <= 0; the Fresnel weight w.  F D V = (F0 + (1 - F0) w) D V.
    """
    alpha = alpha[:, None]
    n_l = torch.einsum("pnc,pc->pn", direction, normal)
    n_v = (view * normal).sum(-1)[:, None]
    half = direction + view[:, None]  # not of unit length
    length2 = (half * half).sum(-1).clamp_min(1e-7)
    tangential = half - (n_l + n_v)[..., None] * normal[:, None]
    above = n_l > 0
    cosine = torch.where(above, n_l, 1.0)
    value = ggx_of_sine((tangential * tangential).sum(-1) / length2, alpha) * smith_visibility(cosine, n_v, alpha)
    return n_l, torch.where(above, value, 0.0), fresnel_weight(0.5 * length2.sqrt())  # |half| = 2 v.h


def irgs_lobe(
    view: torch.Tensor, normal: torch.Tensor, roughness: torch.Tensor, direction: torch.Tensor
) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
    """Evaluate the specular part of IRGS' BRDF without its Fresnel colour, for N directions at each of P points.

    Args:
        view: (P, 3) unit, towards the eye.
        normal: (P, 3) unit.
        roughness: (P,) in 0..1, without a lower bound: the denominator's takes its place.
        direction: (P, N, 3) unit, towards the light.

    Returns:
        Three (P, N) tensors as of `specular_lobe`: n.l; the lobe, zero where n.l <= 0; the Fresnel weight.
    """
    half = torch.nn.functional.normalize(direction + view[:, None], dim=-1)
    cosine, n_h = (torch.einsum("pnc,pc->pn", vector, normal) for vector in (direction, half))
    n_l, n_h, n_v = (value.clamp(1e-6, 1) for value in (cosine, n_h, (view * normal).sum(-1)[:, None]))
    v_h = torch.einsum("pnc,pc->pn", half, view).clamp(1e-6, 1)
    alpha, k = roughness[:, None] ** 2, (roughness[:, None] + 1) ** 2 / 8
    lobe = (n_h**2 * (alpha**2 - 1) + 1) ** 2 * (n_v * (1 - k) + k) * (n_l * (1 - k) + k)
    value = alpha**2 / (4 * math.pi * lobe).clamp(*IRGS_DENOMINATOR)
    first, second = IRGS_FRESNEL
    return cosine, torch.where(cosine > 0, value, 0.0), 2 ** ((first * v_h + second) * v_h)


def visible_normal_density(view: torch.Tensor, direction: torch.Tensor, alpha: torch.Tensor) -> torch.Tensor:
    """Return the density per steradian of view directions mirrored at sampled visible normals, G1(v) D(h) / (4 n.v) (Heitz 2018).

    Args:
        view: (..., 3) unit, in the local frame with the normal along +z.
        direction: (..., 3) unit, in the same frame.
        alpha: (...,) of GGX.

    Returns:
        (...,) density, zero where the half vector points below the surface.
    """
    half = view + direction
    up, n_v = half[..., 2], view[..., 2]
    flat2 = half[..., 0] ** 2 + half[..., 1] ** 2
    a2 = alpha * alpha
    masked = 0.5 / (n_v + (a2 + (1 - a2) * n_v * n_v).sqrt())  # G1 / (4 n.v) without a division by n.v
    return torch.where(up > 0, ggx_of_sine(flat2 / (flat2 + up * up).clamp_min(1e-14), alpha) * masked, 0.0)


def sample_visible_normal(view: torch.Tensor, alpha: torch.Tensor, u: torch.Tensor) -> torch.Tensor:
    """Sample half vectors from the GGX distribution of visible normals (Heitz 2018) by spherical caps (Dupuy and Benyoub 2023).

    Args:
        view: (..., 3) unit, z > 0, in the local frame with the normal along +z.
        alpha: (...,) of GGX.
        u: (..., 2) uniform in [0, 1).

    Returns:
        (..., 3) unit, of density G1(v) D(h) max(v.h, 0) / v.z.
    """
    a = alpha[..., None]
    v = torch.nn.functional.normalize(torch.cat([view[..., :2] * a, view[..., 2:]], -1), dim=-1)
    z = (1 - u[..., 0]) * (1 + v[..., 2]) - v[..., 2]
    r, phi = (1 - z * z).clamp_min(0).sqrt(), 2 * math.pi * u[..., 1]
    h = torch.stack([r * phi.cos(), r * phi.sin(), z], -1) + v
    return torch.nn.functional.normalize(torch.cat([h[..., :2] * a, h[..., 2:].clamp_min(1e-6)], -1), dim=-1)
