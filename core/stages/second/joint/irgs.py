# SPDX-License-Identifier: GPL-3.0-or-later
"""The second stage of IRGS as a baseline: its dielectric BRDF without metal, and its start of materials and light."""

from __future__ import annotations

import math
from dataclasses import replace

import torch

from ....scene.gaussians import ALBEDO, METALLIC, ROUGHNESS
from ....scene.reconstruction import Reconstruction
from ....shading.brdf import DIELECTRIC_F0
from ....shading.sampling import Samples

START_ALBEDO, START_ROUGHNESS, START_LIGHT = 0.3, 0.6, 1.5  # of all Gaussians; radiance of all directions
NO_METAL_LOGIT = -12.0  # logit
MIN_DENOMINATOR, MAX_DENOMINATOR = 1e-6, 4 * math.pi  # bounds of the specular lobe's denominator, which cap lobes of a roughness below 0.12


def irgs_start(start: Reconstruction) -> Reconstruction:
    """Return a reconstruction with constant materials, none of it metal, and constant light."""
    material = torch.empty_like(start.gaussians.material)
    material[ALBEDO], material[ROUGHNESS] = math.log(START_ALBEDO / (1 - START_ALBEDO)), math.log(START_ROUGHNESS / (1 - START_ROUGHNESS))
    material[METALLIC] = NO_METAL_LOGIT
    return replace(
        start, gaussians=replace(start.gaussians, material=material), environment=torch.full_like(start.environment, START_LIGHT)
    )


def reflect_as_irgs(
    view: torch.Tensor,
    normal: torch.Tensor,
    albedo: torch.Tensor,
    roughness: torch.Tensor,
    metallic: torch.Tensor,
    samples: Samples,
    incoming: torch.Tensor,
) -> tuple[torch.Tensor, torch.Tensor]:
    """Estimate the light that P points reflect, by a full diffuse lobe and GGX with Schlick's masking and the denominator's bounds.

    Args:
        view: (P, 3) unit, towards the eye.
        normal: (P, 3) unit.
        albedo: (P, 3) linear, 0..1.
        roughness: (P,) in 0..1.
        metallic: (P,) not used: there is no metal.
        samples: N directions per point.
        incoming: (P, N, 3) linear radiance from those directions.

    Returns:
        Diffuse and specular part, (P, 3) each, linear.
    """
    direction = samples.direction
    half = torch.nn.functional.normalize(direction + view[:, None], dim=-1)
    n_l, n_h = (torch.einsum("pnc,pc->pn", vector, normal) for vector in (direction, half))
    weight = n_l.clamp_min(0) / (samples.density * direction.shape[1])
    n_l, n_h, n_v = (cosine.clamp(1e-6, 1) for cosine in (n_l, n_h, (view * normal).sum(-1)[:, None]))
    v_h = torch.einsum("pnc,pc->pn", half, view).clamp(1e-6, 1)
    alpha, k = roughness[:, None] ** 2, (roughness[:, None] + 1) ** 2 / 8
    # Schlick's (1 - v_h)^5 as a power of 2 (Karis 2013, "Real Shading in Unreal Engine 4").
    fresnel = DIELECTRIC_F0 + (1 - DIELECTRIC_F0) * 2 ** ((-5.55473 * v_h - 6.98316) * v_h)
    lobe = (n_h**2 * (alpha**2 - 1) + 1) ** 2 * (n_v * (1 - k) + k) * (n_l * (1 - k) + k)
    specular = fresnel * alpha**2 / (4 * math.pi * lobe).clamp(MIN_DENOMINATOR, MAX_DENOMINATOR)
    irradiance, gloss = (torch.einsum("pn,pnc->pc", factor, incoming) for factor in (weight, weight * specular))
    return albedo * irradiance / math.pi, gloss
