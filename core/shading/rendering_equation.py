# SPDX-License-Identifier: GPL-3.0-or-later
"""The rendering equation as a sum over samples: light that comes in, made light that goes out."""

from __future__ import annotations

import math

import torch

from ..kernels.reflection import weighted_sums
from ..machine.backend import by_warp
from .brdf import base_reflectance, facing, ggx_alpha, specular_lobe
from .sampling import Samples
from .specular_albedo import diffuse_fraction


def reflect_light(
    view: torch.Tensor,
    normal: torch.Tensor,
    albedo: torch.Tensor,
    roughness: torch.Tensor,
    metallic: torch.Tensor,
    samples: Samples,
    incoming: torch.Tensor,
    conserving: bool = True,
) -> tuple[torch.Tensor, torch.Tensor]:
    """Monte Carlo estimate of the light that P points send to the eye.

    Args:
        view: (P, 3) unit, towards the eye. normal: (P, 3) unit. albedo: (P, 3); roughness, metallic: (P,), all in 0..1.
        samples: from `draw`, constants. incoming: (P, N, 3) linear radiance along them.
        conserving: take from the diffuse lobe what the specular one reflects, as Blender's Principled does; the paper does not.

    Returns:
        Diffuse and specular (P, 3) linear: mean of f L cos / q. Differentiable in materials, normal, view and incoming.
    """
    view, alpha = facing(view, normal), ggx_alpha(roughness)
    plain = incoming.dtype == torch.float32 and not by_warp(incoming)
    sums = (weighted_sums if plain else weighted_sums_reference)(view, normal, alpha, samples.direction, samples.density, incoming)
    irradiance, scaled, added = sums.unbind(1)  # colour comes last
    diffuse = (1 - metallic[:, None]) * albedo * irradiance / math.pi
    if conserving:
        diffuse = diffuse * diffuse_fraction((view * normal).sum(-1), roughness)[:, None]
    return diffuse, base_reflectance(albedo, metallic[:, None]) * scaled + added


def weighted_sums_reference(
    view: torch.Tensor, normal: torch.Tensor, alpha: torch.Tensor, direction: torch.Tensor, density: torch.Tensor, incoming: torch.Tensor
) -> torch.Tensor:
    """The twin of `weighted_sums` in plain operations, for any floating type and device."""
    n_l, value, power = specular_lobe(view, normal, alpha, direction)
    weight = n_l.clamp_min(0) / (density * density.shape[1])
    value = value * weight
    bias = value * power
    return torch.stack([weight, value - bias, bias], 1) @ incoming
