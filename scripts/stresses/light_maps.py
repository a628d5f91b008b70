# SPDX-License-Identifier: GPL-3.0-or-later
"""Extreme light maps, and float64 references of their prefiltering and irradiance."""

from __future__ import annotations

import math

import torch
from irgspp.core.shading.brdf import ggx_alpha, ggx_distribution
from irgspp.core.shading.environment_lookup import lookup, solid_angles, texel_directions


def maps(height: int = 32) -> dict[str, torch.Tensor]:
    """Return extreme light maps (H, W, 3) by name, most of some height."""
    black = torch.zeros(height, 2 * height, 3)
    lamp, pole, seam = black.clone(), black.clone(), black.clone()
    lamp[height // 3, height // 2] = 1e6
    pole[0, 3] = 1e6
    seam[height // 2, [0, -1]] = 1e6
    wild = torch.rand(height, 2 * height, 3, generator=torch.Generator().manual_seed(0)) ** 20 * 1e6
    tiny = torch.tensor([[[1.0, 0.5, 0.2], [0.0, 3.0, 1e6]]])
    named = {"a texel of 1e6": lamp, "at the pole": pole, "on the seam": seam, "1e-12": black + 1e-12, "white": black + 1, "black": black}
    return named | {"0 to 1e6": wild, "2x1": tiny, "1x1": torch.ones(1, 1, 3), "1x2": tiny.transpose(0, 1).contiguous()}


def lattice(count: int) -> torch.Tensor:
    """Return points spread evenly over the unit square, (count, 2) float64."""
    i = torch.arange(count, dtype=torch.float64)
    return torch.stack([(i + 0.5) / count, (i * 0.6180339887498949) % 1], 1)


def filtered(light: torch.Tensor, roughness: float | None) -> torch.Tensor:
    """Prefilter a light map by the definition: every texel is the weighted mean of all others.

    Args:
        light: (H, W, 3).
        roughness: of the GGX lobe; None for the cosine filter.

    Returns:
        (H, W, 3) float64.
    """
    height, width = light.shape[:2]
    towards = texel_directions(height, width, torch.float64).reshape(-1, 3)
    cosine = (towards @ towards.T).clamp(-1, 1)
    weight = solid_angles(height, width, torch.float64).repeat_interleave(width) * cosine.clamp_min(0)
    if roughness is not None:
        weight = weight * ggx_distribution(((1 + cosine) / 2).sqrt(), ggx_alpha(torch.tensor(roughness, dtype=torch.float64)))
    return (weight / weight.sum(1, keepdim=True) @ light.double().reshape(-1, 3)).view(height, width, 3)


def quadrature(light: torch.Tensor, normal: torch.Tensor, finer: int = 8) -> torch.Tensor:
    """Integrate a light map, bilinear between texels, over the hemispheres of planes.

    Args:
        light: (H, W, 3).
        normal: unit normals (P, 3).
        finer: factor of the grid's resolution.

    Returns:
        Irradiance / pi (P, 3), float64.
    """
    height, width = finer * light.shape[0], finer * light.shape[1]
    towards = texel_directions(height, width, torch.float64).reshape(-1, 3)
    shining = lookup(light.double(), towards) * solid_angles(height, width, torch.float64).repeat_interleave(width)[:, None]
    return (normal @ towards.T).clamp_min(0) @ shining / math.pi
