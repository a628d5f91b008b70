# SPDX-License-Identifier: GPL-3.0-or-later
"""The radiance of a sample as a function of its point's albedo, and the robust error of such radiances."""

from __future__ import annotations

import torch

from ....shading.brdf import DIELECTRIC_F0
from .multi_view_samples import MultiViewSamples

CAUCHY_SCALE = 0.02  # encoded difference at which a sample's robust weight is halved (Cauchy)


def view_terms(
    metallic: torch.Tensor, diffuse: torch.Tensor, irradiance: torch.Tensor, f0_term: torch.Tensor, fresnel_term: torch.Tensor
) -> tuple[torch.Tensor, torch.Tensor]:
    """Evaluate c and d of y = a c + d.

    Args:
        metallic: m, (K, 1) or scalar.
        diffuse: 1 - E_s, see `diffuse_fraction`, (K, 1) or scalar.
        irradiance: E, irradiance / pi, (K, 3).
        f0_term: S, the scale of the specular lobe in the split-sum form F0 S + S' (Karis 2013), (K, 3).
        fresnel_term: S', its bias: what Fresnel adds at grazing angles, (K, 3).

    Returns:
        c and d, (K, 3) each.
    """
    return (1 - metallic) * diffuse * irradiance + metallic * f0_term, DIELECTRIC_F0 * (1 - metallic) * f0_term + fresnel_term


def approximate_srgb_derivative(colour: torch.Tensor) -> torch.Tensor:
    """Approximate the derivative of the sRGB encoding by its power law, so that errors count as encoded differences.

    It is constant below 0.003, and does not vanish above 1 as that of a clipped image does.

    Args:
        colour: (...,) linear.
    """
    return 0.44 / colour.clamp_min(3e-3) ** 0.58  # of 1.055 x^(1 / 2.4): 1.055 / 2.4 = 0.44, 1 - 1 / 2.4 = 0.58


def least_squares_albedo(samples: MultiViewSamples, weight: torch.Tensor, factor: torch.Tensor, rest: torch.Tensor) -> torch.Tensor:
    """Fit the albedo of each point to its samples by y = a c + d.

    Args:
        samples: K samples of P points.
        weight: (K, 3) of the squared residuals in linear radiance.
        factor: c, (K, 3).
        rest: d, (K, 3).

    Returns:
        a, (P, 3); it may lie outside 0..1.
    """
    return samples.sums(weight * factor * (samples.colour - rest)) / samples.sums(weight * factor * factor).clamp_min(1e-9)


def robust_error(samples: MultiViewSamples, radiance: torch.Tensor, derivative: torch.Tensor) -> torch.Tensor:
    """Compute the robust error of each point: Cauchy's cost in encoded values, summed over its samples and channels.

    Args:
        samples: K samples of P points; where they are saturated, a higher radiance is no error.
        radiance: (K, 3) linear, by a model.
        derivative: (K, 3) approximate derivative of the sRGB encoding.

    Returns:
        (P,).
    """
    error = (radiance - samples.colour) * derivative
    error = torch.where(samples.saturated & (error > 0), 0.0, error)
    return samples.sums(torch.log1p((error / CAUCHY_SCALE) ** 2).sum(1))
