# SPDX-License-Identifier: GPL-3.0-or-later
"""Estimate of the reflected light from sums over samples, with a measure of its noise."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import torch

from ..kernels.cpu.reflected_light import estimate_range
from ..machine.backend import by_warp
from ..machine.thread_pool import even_ranges, run_ranges, thread_count
from ..shading.brdf import base_reflectance, bend_view_to_normal
from ..shading.environment_lookup import direction_to_uv
from ..shading.specular_albedo import diffuse_fraction
from .indirect_light import SUMS
from .prepared_light import PreparedLight
from .primary_hits import DividedHits, PrimaryHits

MAX_CORRECTION = 2.0  # largest factor by which a sum of few samples is corrected


@dataclass(frozen=True, eq=False)
class Estimate:
    """Light that P surface points reflect.

    The estimate is the sum over even plus the sum over odd samples. The square of their difference has the variance of the estimate as
    its mean, or more than that, since half of a low-discrepancy set is a worse set.

    Attributes:
        diffuse: (P, 3) linear radiance of the diffuse lobe.
        specular: (P, 3) linear radiance of the specular lobe.
        diffuse_split: (P, 3) diffuse light of the even samples minus that of the odd ones.
        specular_split: (P, 3) the same of the specular light.
        samples: samples per point.
    """

    diffuse: torch.Tensor
    specular: torch.Tensor
    diffuse_split: torch.Tensor
    specular_split: torch.Tensor
    samples: int


@dataclass(frozen=True, eq=False)
class Reflectance:
    """What P surface points make of the light that arrives, the same under every light.

    Attributes:
        diffuse: (P, 3) radiance of the diffuse lobe per irradiance.
        f0: (P, 3) reflectance of the specular lobe at normal incidence.
        place: (2, P) u, v of the normal in a light map.
    """

    diffuse: torch.Tensor
    f0: torch.Tensor
    place: torch.Tensor

    @classmethod
    def of(cls, surface: PrimaryHits, conserving: bool) -> Reflectance:
        """Return the reflectance of P points.

        Args:
            surface: the points.
            conserving: reduce the diffuse lobe by what the specular lobe reflects, see `reflect_light`.
        """
        f0 = base_reflectance(surface.albedo, surface.metallic[:, None])
        return cls(diffuse_albedo(surface, conserving) / math.pi, f0, torch.stack(direction_to_uv(surface.normal)))


def estimate_reflected_light(
    sums: torch.Tensor, samples: int, reflectance: Reflectance, light: PreparedLight, ratio: bool = True
) -> Estimate:
    """Turn the sums of `gather` into reflected light.

    The unoccluded irradiance is known exactly from the prefiltered map, so that sampling has to find only the fraction that is visible:
    the ratio estimator of Heitz et al. 2018, "Combining analytic direct illumination and stochastic shadows".

    Args:
        sums: (P, 2, 12) sums over even and odd samples; with lamps (P, 2, 21), the last nine from `lamp_sums`.
        samples: samples per point.
        reflectance: of the P points.
        light: the light of the sums.
        ratio: use the known irradiance; False: the plain sums over samples, as in the paper.
    """
    known = light.irradiance_at(*reflectance.place) if ratio else None
    by_map = sums[..., :SUMS], samples, reflectance, known
    estimate = estimate_reference(*by_map) if by_warp(sums) else _estimate(*by_map)
    return _plus_lamps(estimate, sums[..., SUMS:], reflectance.diffuse, reflectance.f0) if sums.shape[-1] > SUMS else estimate


def _estimate(sums: torch.Tensor, samples: int, reflectance: Reflectance, known: torch.Tensor | None) -> Estimate:
    """Do the same as `estimate_reference` by the CPU's kernel."""
    tensors = (sums, reflectance.diffuse if known is None else known, reflectance.diffuse, reflectance.f0)
    out = np.empty((4, len(sums), 3), np.float32)
    arrays = [t.float().contiguous().numpy() for t in tensors]
    parts = even_ranges(len(sums), thread_count())
    run_ranges(estimate_range, parts, *arrays, known is not None, np.float32(MAX_CORRECTION), out)
    diffuse, specular, diffuse_split, specular_split = torch.from_numpy(out)
    return Estimate(diffuse, specular, diffuse_split, specular_split, samples)


def estimate_reference(sums: torch.Tensor, samples: int, reflectance: Reflectance, known: torch.Tensor | None) -> Estimate:
    """Return the light of a map that P points reflect, by PyTorch operations: on a GPU, and as the reference of the CPU's kernel.

    Args:
        sums: (P, 2, 12) sums over even and odd samples.
        samples: samples per point.
        reflectance: of the P points.
        known: (P, 3) unoccluded irradiance; None: the plain sums over samples.
    """
    (irradiance, f0_term, fresnel_term, unoccluded), split = sums.sum(1).view(-1, 4, 3).unbind(1), (sums[:, 0] - sums[:, 1]).view(-1, 4, 3)
    albedo, f0 = reflectance.diffuse, reflectance.f0
    body, diffuse_split = albedo, albedo * split[:, 0]
    if known is not None:
        factor = torch.where(unoccluded > 0, known / unoccluded.clamp_min(1e-30), 1.0).clamp(1 / MAX_CORRECTION, MAX_CORRECTION)
        body = albedo * factor
        visible_fraction = irradiance / unoccluded.clamp_min(1e-30)
        diffuse_split = body * (split[:, 0] - torch.where(unoccluded > 0, visible_fraction * split[:, 3], 0.0))
    return Estimate(body * irradiance, f0 * f0_term + fresnel_term, diffuse_split, f0 * split[:, 1] + split[:, 2], samples)


def joined_estimate(divided: DividedHits, single: Estimate, rays: Estimate) -> Estimate:
    """Return the light that divided pixels reflect, of that of their single points and that of their rays."""
    rows = (torch.cat([one.diffuse, one.specular, one.diffuse_split, one.specular_split], 1) for one in (single, rays))
    diffuse, specular, diffuse_split, specular_split = divided.joined(*rows).split(3, 1)
    return Estimate(diffuse, specular, diffuse_split, specular_split, single.samples)


def _plus_lamps(estimate: Estimate, sums: torch.Tensor, albedo: torch.Tensor, f0: torch.Tensor) -> Estimate:
    """Add the light of lamps to an estimate.

    Args:
        estimate: light that P points reflect under the light map.
        sums: (P, 2, 9) of `lamp_sums`.
        albedo: (P, 3) of the diffuse lobe over pi.
        f0: (P, 3) reflectance at normal incidence.
    """
    (irradiance, f0_term, fresnel_term), split = sums.sum(1).view(-1, 3, 3).unbind(1), (sums[:, 0] - sums[:, 1]).view(-1, 3, 3)
    return Estimate(
        estimate.diffuse + albedo * irradiance,
        estimate.specular + f0 * f0_term + fresnel_term,
        estimate.diffuse_split + albedo * split[:, 0],
        estimate.specular_split + f0 * split[:, 1] + split[:, 2],
        estimate.samples,
    )


def diffuse_albedo(surface: PrimaryHits, conserving: bool) -> torch.Tensor:
    """Return the fraction of the irradiance that the diffuse lobe reflects, (P, 3).

    Args:
        surface: the P points.
        conserving: reduce the diffuse lobe by what the specular lobe reflects, see `reflect_light`.
    """
    body = (1 - surface.metallic[:, None]) * surface.albedo
    if not conserving:
        return body
    n_v = (bend_view_to_normal(surface.view, surface.normal) * surface.normal).sum(-1)
    return body * diffuse_fraction(n_v, surface.roughness)[:, None]
