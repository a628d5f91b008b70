# SPDX-License-Identifier: GPL-3.0-or-later
"""Light prepared for relighting: the map itself for primary surfaces, prefiltered maps for what they reflect, and a sample table."""

from __future__ import annotations

import dataclasses
import math
from dataclasses import dataclass
from functools import cache

import numpy as np
import torch

from ..rendering.gbuffer import downsampled_light
from ..shading.environment_lookup import direction_to_uv, lookup, lookup_at
from ..shading.sampling import LightDistribution
from ..shading.split_sum import diffuse_light, specular_light

TABLE_BITS = 8  # 256 x 256 directions to draw from: far more than the samples of a pixel


@dataclass(frozen=True, eq=False)
class PreparedLight:
    """A light map with everything derived from it, built once for all its rotations about +Z.

    Attributes:
        radiance: (H, W, 3) linear, lat-long.
        distribution: density for drawing directions by radiance; None for a black light.
        diffuse: (h, w, 3) irradiance / pi.
        specular: (L, h, w, 3) stack filtered per roughness.
        table: (T, T, 7) float32 direction, density per steradian and radiance of equally likely samples, by position in the unit square.
        turn: rotation about +Z, counter-clockwise seen from above, as a fraction of a full turn in [0, 1).
    """

    radiance: torch.Tensor
    distribution: LightDistribution | None
    diffuse: torch.Tensor
    specular: torch.Tensor
    table: torch.Tensor
    turn: float = 0.0

    def to(self, device: torch.device) -> PreparedLight:
        """Return the light on a device."""
        if self.radiance.device == device:
            return self
        moved = {name: getattr(self, name).to(device) for name in ("radiance", "diffuse", "specular", "table")}
        return dataclasses.replace(self, **moved, distribution=None if self.distribution is None else LightDistribution(moved["radiance"]))

    def turned(self, degrees: float) -> PreparedLight:
        """Return the light rotated further about +Z, counter-clockwise seen from above, by an angle in degrees.

        Nothing is computed again, and no texel is interpolated.
        """
        return dataclasses.replace(self, turn=(self.turn + degrees / 360) % 1)

    def irradiance(self, normal: torch.Tensor) -> torch.Tensor:
        """Return the unoccluded irradiance (P, 3) of surfaces with unit normals (P, 3)."""
        return self.irradiance_at(*direction_to_uv(normal))

    def irradiance_at(self, u: torch.Tensor, v: torch.Tensor) -> torch.Tensor:
        """Return the unoccluded irradiance (P, 3) of surfaces whose normals have u, v, (P,) each, in the map before it was rotated."""
        return lookup_at(self.diffuse, self.turned_u(u), v) * math.pi

    def turned_u(self, u: torch.Tensor) -> torch.Tensor:
        """Return the coordinates u (P,) in the maps of directions that have `u` (P,) before the light was rotated."""
        return (u + self.turn) % 1


def prepare_light(light: np.ndarray, device: torch.device | str = "cpu") -> PreparedLight:
    """Prepare a light map for relighting.

    Args:
        light: (H, W, 3) linear lat-long map, finite and >= 0.
        device: device of the result.
    """
    radiance = torch.from_numpy(np.ascontiguousarray(light, np.float32)).to(device)
    small = downsampled_light(light).to(device)
    distribution = LightDistribution(radiance) if float(radiance.max()) > 0 else None
    table = radiance.new_zeros(0, 0, 7) if distribution is None else _table(radiance, distribution)
    return PreparedLight(radiance, distribution, diffuse_light(small).contiguous(), specular_light(small).contiguous(), table)


def _table(radiance: torch.Tensor, distribution: LightDistribution) -> torch.Tensor:
    """Return the sample table (T, T, 7) of `PreparedLight`."""
    direction = distribution.sample(_stratified_points().to(radiance.device)).float()
    flat = direction.view(-1, 3)
    values = (flat, distribution.density(flat)[:, None], lookup(radiance, flat))
    return torch.cat(values, 1).view(*direction.shape[:2], 7).contiguous()


@cache
def _stratified_points() -> torch.Tensor:
    """Return one point u, v per cell of the unit square, row by row, (T, T, 2).

    All u differ, and all v differ (bit reversal): on a plain grid, lamps between the rows would be missed.
    """
    size = 1 << TABLE_BITS
    i = torch.arange(size)
    reverse = sum(((i >> bit) & 1) << (TABLE_BITS - 1 - bit) for bit in range(TABLE_BITS))
    assert isinstance(reverse, torch.Tensor)
    inside = (reverse.double() + 0.5) / size
    u = (i.double()[None] + inside[:, None]) / size
    v = (i.double()[:, None] + inside[None]) / size
    return torch.stack([u, v], -1)
