# SPDX-License-Identifier: GPL-3.0-or-later
"""Light transport to single points, traced once and kept: geometry is frozen, so what a point sees never changes.

With it the image is linear in the light, and no estimate: light, albedo and gloss can be told apart without noise.
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

RAYS = 1 << 18  # at a time, unless memory is short


@contextmanager
def rays_at_a_time(count: int) -> Iterator[None]:
    """Within the block, about so many rays are at work at a time: the result is the same, memory and speed are less with fewer."""
    global RAYS
    before, RAYS = RAYS, count
    try:
        yield
    finally:
        RAYS = before


def subdivided_directions(height: int, side: int, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """side x side strata in every texel of a lat-long map: directions (3, D) and solid angles (D,), float32; D runs over texels first."""
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
    """What P points receive from T texels of a light and from each other.

    Attributes:
        height: rows of the light; T = 2 height^2.
        fixed: directions (3, D), solid angles (D,), visible (P, D), indirect (P, 3, D), float32, as `core/kernels/lobes.py` wants them:
            numpy's arrays on the CPU, tensors on a device.
        irradiance: (P, T) irradiance / pi per radiance of a texel. indirect: (P, 3) irradiance / pi from the object itself.
        bounces: False where the object's own light was left out.
    """

    height: int
    fixed: tuple[Any, ...]
    irradiance: torch.Tensor
    indirect: torch.Tensor
    bounces: bool

    def arrays(self, *tensors: torch.Tensor) -> tuple[Any, ...]:
        """Tensors as what `fixed` is: numpy's arrays of the same memory, or tensors as they are."""
        return tensors if isinstance(self.fixed[0], torch.Tensor) else tuple(t.numpy() for t in tensors)

    def rows(self, seen: MultiViewSamples, roughness: torch.Tensor) -> tuple[torch.Tensor, ...]:
        """Specular rows of all views for the points' roughness (P,): see `lobe_rows`."""
        point, view, normal, alpha = self.arrays(seen.point, seen.view, seen.normal, ggx_alpha(roughness))
        return tuple(map(torch.as_tensor, lobe_rows(point, view, normal, alpha, self.fixed, 2 * self.height**2)))

    def sums(self, seen: MultiViewSamples, roughness: torch.Tensor, light: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        """Specular integrals (K, J, 3) of all views for J roughness values under a light (T, 3): see `lobe_sums`."""
        point, view, normal, alphas, shining = self.arrays(seen.point, seen.view, seen.normal, ggx_alpha(roughness), light)
        scaled, added = lobe_sums(point, view, normal, alphas, self.fixed, shining)
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
    """Trace the hemispheres of P points; `indirect` False leaves out what the object reflects onto itself (it still casts shadows).

    `step` is told how many points are done and may raise.
    """
    direction, angle = (torch.from_numpy(a).to(position.device) for a in subdivided_directions(height, side, seed))
    cosine = (normal @ direction).clamp_min(0)
    visible, other = _look_around(tracer.above(position, normal), direction, cosine > 0, tracer, step)
    if not indirect:
        other.zero_()
    weight = cosine * angle / math.pi
    rows = (weight * visible).view(len(position), side * side, 2 * height * height).sum(1)
    own = torch.einsum("pd,pcd->pc", weight, other)
    fixed = (direction, angle, visible, other)
    return RadianceTransfer(height, fixed if by_warp(position) else tuple(t.numpy() for t in fixed), rows, own, indirect)


def _look_around(
    origin: torch.Tensor, direction: torch.Tensor, wanted: torch.Tensor, tracer: SecondaryTracer, step: Callable[[int], object]
) -> tuple[torch.Tensor, torch.Tensor]:
    """What P origins see in those of the directions (3, D) that are `wanted` (P, D): free (P, D) and radiance (P, 3, D), else 0."""
    points, count = wanted.shape
    visible, other = origin.new_zeros(points, count), origin.new_zeros(points, 3, count)
    toward, batch = direction.T.contiguous(), max(1, 2 * RAYS // count)
    for begin in range(0, points, batch):
        p, d = torch.nonzero(wanted[begin : begin + batch], as_tuple=True)
        free, radiance = tracer.look(origin[begin + p], toward[d])
        visible[begin + p, d] = free
        other[begin + p, :, d] = radiance
        step(min(begin + batch, points))
    return visible, other
