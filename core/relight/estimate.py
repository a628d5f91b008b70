# SPDX-License-Identifier: GPL-3.0-or-later
"""From sums over samples to reflected light, and how far it is to be trusted."""

from __future__ import annotations

import math
from dataclasses import dataclass

import torch

from ..shading.brdf import base_reflectance, facing
from ..shading.specular_albedo import diffuse_fraction
from .prepared_light import PreparedLight
from .primary_hits import PrimaryHits

RATIO = 2.0  # by so much at most a sum of few samples is corrected


@dataclass(frozen=True, eq=False)
class Estimate:
    """Light that P surface points reflect.

    Attributes:
        diffuse, specular: (P, 3). diffuse_split, specular_split: (P, 3) how much more of each the even samples bring than the odd ones:
            its square is, on average, the variance (or more: halves of a low-discrepancy set are worse than its half).
        samples: how many a point has, the same for all or (P, 1).
    """

    diffuse: torch.Tensor
    specular: torch.Tensor
    diffuse_split: torch.Tensor
    specular_split: torch.Tensor
    samples: int | torch.Tensor


def estimated(sums: torch.Tensor, samples: int | torch.Tensor, surface: PrimaryHits, light: PreparedLight, conserving: bool) -> Estimate:
    """Reflected light from (P, 2, 12) sums of `gather` over so many samples.

    Without anything in its way the diffuse light is known exactly, from the prefiltered map; so sampling has to tell the share of it
    that arrives and no more (Heitz et al. 2018, Combining analytic direct illumination and stochastic shadows).
    """
    (irradiance, scaled, added, free), split = sums.sum(1).view(-1, 4, 3).unbind(1), (sums[:, 0] - sums[:, 1]).view(-1, 4, 3)
    known = light.irradiance(surface.normal)
    factor = torch.where(free > 0, known / free.clamp_min(1e-30), 1.0).clamp(1 / RATIO, RATIO)
    body = diffuse_albedo(surface, conserving) / math.pi * factor
    arriving = irradiance / free.clamp_min(1e-30)
    f0 = base_reflectance(surface.albedo, surface.metallic[:, None])
    diffuse_split = body * (split[:, 0] - torch.where(free > 0, arriving * split[:, 3], 0.0))
    return Estimate(body * irradiance, f0 * scaled + added, diffuse_split, f0 * split[:, 1] + split[:, 2], samples)


def diffuse_albedo(surface: PrimaryHits, conserving: bool) -> torch.Tensor:
    """(P, 3) share of the irradiance that the diffuse lobe sends back; `conserving`: see `reflect_light`."""
    body = (1 - surface.metallic[:, None]) * surface.albedo
    if not conserving:
        return body
    n_v = (facing(surface.view, surface.normal) * surface.normal).sum(-1)
    return body * diffuse_fraction(n_v, surface.roughness)[:, None]
