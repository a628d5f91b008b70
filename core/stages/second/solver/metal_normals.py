# SPDX-License-Identifier: GPL-3.0-or-later
"""Normals and roughness of metal by its reflections, in several views each and under a known light.

Fused depth leaves the normals of metal wrong by 8 to 20 degrees, and a reflection in the wrong place looks like that of a rougher metal:
with normals fixed, the search found a roughness of .30 to .70 on four scenes whose metals have .20 to .26. Here normals around that of
the surface are tried with every roughness, and the best one counts for each roughness (a profile likelihood).
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import torch

from ...common.nearest_neighbours import nearest_neighbours
from .multi_view_samples import MultiViewSamples
from .parabola import parabola_minimum
from .radiance_transfer import RadianceTransfer
from .sample_equation import approximate_srgb_derivative, least_squares_albedo, robust_error

SEARCHED_ROUGHNESS = (0.1, 0.15, 0.2, 0.25, 0.3, 0.4, 0.5, 0.6, 0.7)
RING_ANGLE, RINGS = math.radians(4), 4  # distance of the rings of normals that are tried, and their number
TURN_COST = 0.15  # robust error of a view that a turn by RING_ANGLE costs; it rises with the square of the turn
ROUGHNESS_NEIGHBOURS = 64  # nearest points that share their roughness
# Multiple of the points' median error up to which metal counts in full for the light. With 1, rocker_corner's metal itself fits worse (new
# views lose .8 dB); with 10, suzanne_mixed's light gains nothing.
TRUSTED_ERROR = 5.0
LEAST_ERROR = 0.1  # median error that counts at least: about that of encoded values which differ by 1 / 255


def reflected_normals(
    samples: MultiViewSamples, transfer: RadianceTransfer, light: torch.Tensor, surface_normal: torch.Tensor
) -> tuple[torch.Tensor, torch.Tensor]:
    """Find the normals and the roughness with which metal reflects what the photographs show, with the best albedo for each.

    Args:
        samples: K samples of P points of metal.
        transfer: radiance transfer to the points.
        light: (T, 3) linear radiance of the texels.
        surface_normal: (P, 3) unit normals of the surface, around which is searched.

    Returns:
        (P, 3) unit normals, and roughness (P,).
    """
    knots = light.new_tensor(SEARCHED_ROUGHNESS)
    least, normal = search_normals(samples, transfer, light, surface_normal, knots)
    shared = _averaged(samples.position, least)
    row = torch.arange(len(normal), device=normal.device)
    return normal[row, shared.argmin(1)], parabola_minimum(knots, shared)


def turned_metal(
    samples: MultiViewSamples, transfer: RadianceTransfer, light: torch.Tensor, surface_normal: torch.Tensor, metal: torch.Tensor
) -> tuple[torch.Tensor, torch.Tensor]:
    """Fit points as metal, with the best normal near the surface's, and with the roughness of the metal nearby.

    Args:
        samples: K samples of P points.
        transfer: radiance transfer to the points.
        light: (T, 3) linear radiance of the texels.
        surface_normal: (P, 3) unit normals of the surface, around which is searched.
        metal: (P,) bool, points known to be metal, at least one.

    Returns:
        (P,) mean error of a view, with what the turn costs, and the albedo (P, 3), which may exceed 1.
    """
    knots = light.new_tensor(SEARCHED_ROUGHNESS)
    of_metal, _ = search_normals(samples.subset(metal), transfer.subset(metal), light, surface_normal[metal], knots)
    nearby = nearest_neighbours(samples.position[metal], samples.position, ROUGHNESS_NEIGHBOURS)
    roughness = of_metal[nearby].mean(1).argmin(1)
    least, albedo = light.new_empty(len(metal)), light.new_empty(len(metal), 3)
    for knot in roughness.unique():
        chosen = roughness == knot
        some, to_some, value = samples.subset(chosen), transfer.subset(chosen), knots[knot : knot + 1]
        errors, normal = search_normals(some, to_some, light, surface_normal[chosen], value)
        least[chosen] = errors[:, 0]
        (albedo[chosen],), _ = _fits(replace(some, normal=normal[:, 0].contiguous()), to_some, light, value)
    return least, albedo


def metal_trust(error: torch.Tensor, metal: torch.Tensor) -> torch.Tensor:
    """Return how much each point counts for the light: a point of metal that fits badly less, as its normal may still be wrong.

    With it, the light gains .8, .2, .2 and 0 dB at the end of the solver on rocker_corner, suzanne_mixed, capture_ogre and a glazed vase.

    Args:
        error: (P,) mean robust error of a view.
        metal: (P,) bool.

    Returns:
        (P,) in 0..1, 1 for a dielectric.
    """
    return torch.where(metal, (TRUSTED_ERROR * error.median().clamp_min(LEAST_ERROR) / error.clamp_min(1e-9)).clamp(max=1), 1.0)


def search_normals(
    samples: MultiViewSamples, transfer: RadianceTransfer, light: torch.Tensor, around: torch.Tensor, knots: torch.Tensor
) -> tuple[torch.Tensor, torch.Tensor]:
    """Find the normals with which metal of given roughness reflects best what the photographs show.

    Args:
        samples: K samples of P points of metal.
        transfer: radiance transfer to the points.
        light: (T, 3) linear radiance of the texels.
        around: (P, 3) unit normals around which is searched.
        knots: (J,) values of roughness.

    Returns:
        The least error of a view (P, J), with what the turn costs, and the unit normals (P, J, 3) that have it.
    """
    least = light.new_full((len(around), len(knots)), math.inf)
    normal = around[:, None].repeat(1, len(knots), 1)
    for turn, turned in _turned(around):
        _, errors = _fits(replace(samples, normal=turned), transfer, light, knots)
        cost = errors + TURN_COST * (turn / RING_ANGLE) ** 2
        better = cost < least
        least = torch.where(better, cost, least)
        normal = torch.where(better[..., None], turned[:, None], normal)
    return least, normal


def _turned(normal: torch.Tensor) -> Iterator[tuple[float, torch.Tensor]]:
    """Yield an angle in radians and unit normals (P, 3) turned by it: the given ones with 0, then those on rings around them."""
    across = torch.linalg.cross(_least_axis(normal), normal)
    across = across / across.norm(dim=1, keepdim=True)
    along = torch.linalg.cross(normal, across)
    yield 0.0, normal
    for ring in range(1, RINGS + 1):
        turn = ring * RING_ANGLE
        for direction in np.linspace(0, 2 * math.pi, 6 * ring, endpoint=False):
            tangent = math.cos(direction) * across + math.sin(direction) * along
            yield turn, (math.cos(turn) * normal + math.sin(turn) * tangent).contiguous()


def _least_axis(normal: torch.Tensor) -> torch.Tensor:
    """Return the coordinate axis (P, 3) that is farthest from each normal."""
    return torch.nn.functional.one_hot(normal.abs().argmin(1), 3).to(normal)


def _fits(
    samples: MultiViewSamples, transfer: RadianceTransfer, light: torch.Tensor, knots: torch.Tensor
) -> tuple[list[torch.Tensor], torch.Tensor]:
    """Fit the albedo of points as metal of roughness `knots` (J,): one (P, 3) for each, and the mean robust error of a view (P, J)."""
    derivative = approximate_srgb_derivative(samples.colour)
    f0_term, fresnel_term = transfer.sums(samples, knots, light)
    albedo, errors = [], []
    for factor, rest in zip(f0_term.unbind(1), fresnel_term.unbind(1), strict=True):  # y = a S + S' for a metal
        albedo.append(least_squares_albedo(samples, derivative**2, factor, rest))
        errors.append(robust_error(samples, albedo[-1].clamp(0, 1)[samples.point] * factor + rest, derivative))
    return albedo, torch.stack(errors, 1) / samples.lengths[:, None]


def _averaged(position: torch.Tensor, values: torch.Tensor) -> torch.Tensor:
    """Average values (P, J) over the ROUGHNESS_NEIGHBOURS nearest points."""
    return values[nearest_neighbours(position, position, ROUGHNESS_NEIGHBOURS)].mean(1)
