# SPDX-License-Identifier: GPL-3.0-or-later
"""Monte Carlo estimator of the rendering equation: the light that surface points reflect to the eye.

L_o = 1/N sum f(v, l_i) L_i(l_i) n.l_i / q(l_i), with the density q of the mixture of sampling strategies (`sampling.py`).
"""

from __future__ import annotations

import math

import torch

from ..kernels.reflection import weighted_sums
from ..settings.schema import Brdf
from .brdf import base_reflectance, bend_view_to_normal, ggx_alpha, irgs_lobe, specular_lobe
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
    brdf: Brdf = "principled",
) -> tuple[torch.Tensor, torch.Tensor]:
    """Estimate the light that P points reflect to the eye.

    Args:
        view: (P, 3) unit, towards the eye.
        normal: (P, 3) unit.
        albedo: (P, 3) linear, 0..1.
        roughness: (P,) in 0..1.
        metallic: (P,) in 0..1; IRGS' BRDF has no metal and does not use it.
        samples: N directions per point from `draw`, treated as constants.
        incoming: (P, N, 3) linear radiance from those directions.
        conserving: reduce the diffuse lobe by what the specular lobe reflects, as Blender's Principled BSDF does; the paper does not,
            nor does IRGS' BRDF.
        brdf: reflectance model, see `brdf.py`.

    Returns:
        Diffuse and specular part, (P, 3) each, linear: means of f L cos / q. Differentiable with respect to materials, normal, view and
        incoming light.
    """
    view, sampled = bend_view_to_normal(view, normal), (samples.direction, samples.density, incoming)
    if brdf == "irgs":
        sums, metallic, conserving = irgs_sums(view, normal, roughness, *sampled), torch.zeros_like(metallic), False
    else:
        use_kernel = incoming.dtype == torch.float32
        sums = (weighted_sums if use_kernel else weighted_sums_reference)(view, normal, ggx_alpha(roughness), *sampled)
    irradiance, f0_term, fresnel_term = sums.unbind(1)  # the last axis is colour
    diffuse = (1 - metallic[:, None]) * albedo * irradiance / math.pi
    if conserving:
        diffuse = diffuse * diffuse_fraction((view * normal).sum(-1), roughness)[:, None]
    return diffuse, base_reflectance(albedo, metallic[:, None]) * f0_term + fresnel_term


def weighted_sums_reference(
    view: torch.Tensor, normal: torch.Tensor, alpha: torch.Tensor, direction: torch.Tensor, density: torch.Tensor, incoming: torch.Tensor
) -> torch.Tensor:
    """Compute `weighted_sums` in PyTorch operations, for any floating type and device: its reference implementation.

    Args:
        view: (P, 3) unit, n.v > 0.
        normal: (P, 3) unit.
        alpha: (P,) of GGX.
        direction: (P, N, 3) unit.
        density: (P, N) per steradian.
        incoming: (P, N, 3) linear radiance.

    Returns:
        (P, 3, 3) means over samples: light for the diffuse lobe, for F0 and for what Fresnel adds; the last axis is colour.
    """
    return _lobe_sums(*specular_lobe(view, normal, alpha, direction), density, incoming)


def irgs_sums(
    view: torch.Tensor,
    normal: torch.Tensor,
    roughness: torch.Tensor,
    direction: torch.Tensor,
    density: torch.Tensor,
    incoming: torch.Tensor,
) -> torch.Tensor:
    """Compute the sums of `weighted_sums` for IRGS' BRDF, by PyTorch operations; differentiable.

    Args:
        view: (P, 3) unit, n.v > 0.
        normal: (P, 3) unit.
        roughness: (P,) in 0..1.
        direction: (P, N, 3) unit.
        density: (P, N) per steradian.
        incoming: (P, N, 3) linear radiance.

    Returns:
        (P, 3, 3), see `weighted_sums_reference`.
    """
    return _lobe_sums(*irgs_lobe(view, normal, roughness, direction), density, incoming)


def _lobe_sums(
    n_l: torch.Tensor, value: torch.Tensor, fresnel: torch.Tensor, density: torch.Tensor, incoming: torch.Tensor
) -> torch.Tensor:
    """Average incoming light, weighted by the cosine (P, N) and by the parts of a lobe with this value and Fresnel weight, (P, N) each."""
    weight = n_l.clamp_min(0) / (density * density.shape[1])
    value = value * weight
    bias = value * fresnel
    return torch.stack([weight, value - bias, bias], 1) @ incoming
