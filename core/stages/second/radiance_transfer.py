# SPDX-License-Identifier: GPL-3.0-or-later
"""Precomputed radiance transfer (Sloan et al. 2002) to surface points: traced once, as geometry is frozen.

With it the image is linear in the light and free of Monte Carlo noise, so that light, albedo and gloss can be separated.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch

from ...kernels.lobes import lobe_rows, lobe_sums
from ...machine.backend import by_warp
from ...rendering.secondary_rays import SecondaryTracer
from ...shading.brdf import ggx_alpha
from ...shading.environment_lookup import solid_angles
from .multi_view_samples import MultiViewSamples

RAYS = 1 << 18  # traced at a time, unless memory is short


@contextmanager
def rays_at_a_time(count: int) -> Iterator[None]:
    """Trace about `count` rays at a time within the block: fewer need less memory and more time; the result is the same."""
    global RAYS
    before, RAYS = RAYS, count
    try:
        yield
    finally:
        RAYS = before


def subdivided_directions(height: int, side: int, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Draw one direction in each of side x side strata of every texel of a lat-long map.

    Args:
        height: rows of the map, which has 2 height columns.
        side: strata along a side of a texel.
        seed: of the positions within the strata.

    Returns:
        Unit directions (3, D) and solid angles (D,) in steradians, float32, D = side^2 x 2 height^2; texels run fastest.
    """
    random, width = np.random.default_rng(seed), 2 * height
    edges = np.cos(np.arange(height + 1) * (math.pi / height))[:, None]
    parts = []
    for i in range(side):
        for j in range(side):
            down, across = (i + random.random((height, width))) / side, (j + random.random((height, width))) / side
            z = edges[:-1] + (edges[1:] - edges[:-1]) * down
            phi = math.pi - (np.arange(width) + across) * (2 * math.pi / width)
            r = np.sqrt(1 - z * z)
            parts.append(np.stack([r * np.cos(phi), r * np.sin(phi), z]).reshape(3, -1))
    angle = np.repeat(solid_angles(height, width, torch.float64).numpy() / side**2, width)
    return np.concatenate(parts, 1).astype(np.float32), np.tile(angle, side**2).astype(np.float32)


@dataclass(frozen=True, eq=False)
class RadianceTransfer:
    """Radiance transfer from T texels of a light map, and from the object itself, to P points.

    Attributes:
        height: rows of the light map; T = 2 height^2.
        fixed: directions (3, D), solid angles (D,), visibility (P, D) and indirect radiance (P, 3, D), float32, as `core/kernels/lobes.py`
            takes them: numpy arrays on the CPU, tensors on a GPU.
        irradiance: (P, T) irradiance / pi per unit radiance of a texel.
        indirect: (P, 3) irradiance / pi of the light that the object reflects onto itself.
        bounces: False where that light was left out.
    """

    height: int
    fixed: tuple[Any, ...]
    irradiance: torch.Tensor
    indirect: torch.Tensor
    bounces: bool

    def arrays(self, *tensors: torch.Tensor) -> tuple[Any, ...]:
        """Convert tensors (...,) to the type of `fixed`: numpy arrays that share memory, or the tensors themselves."""
        return tensors if isinstance(self.fixed[0], torch.Tensor) else tuple(t.numpy() for t in tensors)

    def rows(self, samples: MultiViewSamples, roughness: torch.Tensor) -> tuple[torch.Tensor, ...]:
        """Compute the specular lobe of each sample as weights of the texels, see `lobe_rows`.

        Args:
            samples: K samples of the P points.
            roughness: (P,) of the points.

        Returns:
            The part that F0 scales and the part that Fresnel adds, (K, T) each, and both parts of the indirect light, (K, 3) each.
        """
        point, view, normal, alpha = self.arrays(samples.point, samples.view, samples.normal, ggx_alpha(roughness))
        return tuple(map(torch.as_tensor, lobe_rows(point, view, normal, alpha, self.fixed, 2 * self.height**2)))

    def sums(self, samples: MultiViewSamples, roughness: torch.Tensor, light: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        """Integrate the specular lobe of each sample for several roughness values, see `lobe_sums`.

        Args:
            samples: K samples of the P points.
            roughness: (J,) values, the same for all points.
            light: (T, 3) linear radiance.

        Returns:
            The part that F0 scales and the part that Fresnel adds, (K, J, 3) each, with indirect light.
        """
        point, view, normal, alphas, radiance = self.arrays(samples.point, samples.view, samples.normal, ggx_alpha(roughness), light)
        scaled, added = lobe_sums(point, view, normal, alphas, self.fixed, radiance)
        return torch.as_tensor(scaled), torch.as_tensor(added)


def trace_radiance_transfer(
    position: torch.Tensor,
    normal: torch.Tensor,
    tracer: SecondaryTracer,
    height: int,
    side: int,
    seed: int,
    indirect: bool,
    step: Callable[[int], object] = lambda done: None,
) -> RadianceTransfer:
    """Trace the hemispheres of P points.

    Args:
        position: (P, 3) world.
        normal: (P, 3) unit.
        tracer: of the Gaussians.
        height: rows of the light map.
        side: rays through each texel along a side.
        seed: of the ray directions.
        indirect: with the light that the object reflects onto itself; it casts shadows in any case.
        step: called with the number of points done; may raise.
    """
    direction, angle = (torch.from_numpy(a).to(position.device) for a in subdivided_directions(height, side, seed))
    cosine = (normal @ direction).clamp_min(0)
    visible, incoming = _trace_directions(tracer.above(position, normal), direction, cosine > 0, tracer, step)
    if not indirect:
        incoming.zero_()
    weight = cosine * angle / math.pi
    rows = (weight * visible).view(len(position), side * side, 2 * height * height).sum(1)
    own = torch.einsum("pd,pcd->pc", weight, incoming)
    fixed = (direction, angle, visible, incoming)
    return RadianceTransfer(height, fixed if by_warp(position) else tuple(t.numpy() for t in fixed), rows, own, indirect)


def _trace_directions(
    origin: torch.Tensor, direction: torch.Tensor, selected: torch.Tensor, tracer: SecondaryTracer, step: Callable[[int], object]
) -> tuple[torch.Tensor, torch.Tensor]:
    """Trace rays from origins (P, 3) in `selected` (P, D) directions (3, D): transmittance (P, D), radiance (P, 3, D); else 0."""
    points, count = selected.shape
    visible, incoming = origin.new_zeros(points, count), origin.new_zeros(points, 3, count)
    toward, batch = direction.T.contiguous(), max(1, 2 * RAYS // count)
    for begin in range(0, points, batch):
        p, d = torch.nonzero(selected[begin : begin + batch], as_tuple=True)
        free, radiance = tracer.look(origin[begin + p], toward[d])
        visible[begin + p, d] = free
        incoming[begin + p, :, d] = radiance
        step(min(begin + batch, points))
    return visible, incoming
