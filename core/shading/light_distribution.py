# SPDX-License-Identifier: GPL-3.0-or-later
"""Importance sampling of a lat-long light map: directions drawn in proportion to its brightness."""

from __future__ import annotations

import math

import torch

from .environment_lookup import direction_to_uv, solid_angles

FLOOR = 1e-3  # fraction of the mean added to every texel, so that black ones keep a density above 0
SIDE = 1 / 6  # blur weight of either neighbour: bilinear lookup spreads light half a texel over a texel's edge


class LightDistribution:
    """Piecewise constant density over the sphere, one value per texel of a lat-long map; built again whenever the map changes.

    A texel's weight is its brightest channel, blurred over the 3 x 3 neighbourhood, times its exact solid angle. Everything is detached.
    A map that is black everywhere gives the uniform density.

    Args:
        light: (H, W, 3) linear, finite; negative values count as black.

    Attributes:
        rows: (H,) float64 cumulated probability of the rows.
        columns: (H W,) float64 row number plus cumulated probability within the row.
        edges: (H + 1,) float64 cosines of the rows' edges.
        texels: (H W,) density per steradian.
        height: rows of the map.
        width: columns of the map.

    Raises:
        ValueError: when the light has another shape or, on the CPU, values that are not finite.
    """

    def __init__(self, light: torch.Tensor) -> None:
        """Build the tables of a light map (H, W, 3)."""
        if light.ndim != 3 or light.shape[2] != 3 or 0 in light.shape:
            raise ValueError(f"a light map must have the shape (H, W, 3), got {tuple(light.shape)}")
        with torch.no_grad():
            self._build(light.detach().amax(-1).clamp_min(0))

    def _build(self, brightness: torch.Tensor) -> None:
        """Build the tables from the brightness of texels, (H, W)."""
        height, width = brightness.shape
        angle = solid_angles(height, width, torch.float64, brightness.device)
        value = _blurred(brightness.double())
        mean = (value.sum(1) * angle).sum() / (4 * math.pi)
        if mean.device.type == "cpu" and not torch.isfinite(mean):  # not on a GPU, which would have to be waited for
            raise ValueError("the light map holds infinite or NaN values")
        value = torch.where(mean > 0, value + FLOOR * mean, 1.0)
        weight = value * angle[:, None]
        rows = weight.sum(1)
        # One table for the columns of all rows: the cumulated probabilities of row r lie in r..r+1.
        conditional = weight.cumsum(1) / rows[:, None]
        conditional[:, -1] = 1
        self.rows = (rows.cumsum(0) / rows.sum()).contiguous()
        self.columns = (conditional + torch.arange(height, device=weight.device)[:, None]).reshape(-1)
        self.edges = torch.cos(torch.arange(height + 1, dtype=torch.float64, device=weight.device) * (math.pi / height))
        self.texels = (value / weight.sum()).to(brightness.dtype).reshape(-1)
        self.height, self.width = height, width

    def sample(self, u: torch.Tensor) -> torch.Tensor:
        """Map uniform numbers (..., 2) in [0, 1) to unit directions (..., 3), uniform in solid angle inside each texel."""
        across, down = u.reshape(-1, 2).double().unbind(-1)
        row = torch.searchsorted(self.rows, down.contiguous(), right=True).clamp_max(self.height - 1)
        before = torch.where(row > 0, self.rows[row - 1], 0.0)
        v = ((down - before) / (self.rows[row] - before)).clamp(0, 1)
        flat = torch.searchsorted(self.columns, across + row, right=True)
        flat = torch.minimum(flat, row * self.width + self.width - 1)
        left = torch.where(flat % self.width > 0, self.columns[flat - 1], row.double())
        phi = (flat % self.width + ((across + row - left) / (self.columns[flat] - left)).clamp(0, 1)) * (2 * math.pi / self.width)
        z = self.edges[row] + (self.edges[row + 1] - self.edges[row]) * v
        s = (1 - z * z).clamp_min(0).sqrt()
        return torch.stack([-s * phi.cos(), s * phi.sin(), z], -1).to(u.dtype).view(*u.shape[:-1], 3)

    def density(self, direction: torch.Tensor) -> torch.Tensor:
        """Return the density per steradian, (...,), of unit directions (..., 3); it integrates to 1 over the sphere."""
        u, v = direction_to_uv(direction)
        column = (u * self.width).long().clamp(0, self.width - 1)
        row = (v * self.height).long().clamp(0, self.height - 1)
        return self.texels[row * self.width + column]


def _blurred(brightness: torch.Tensor) -> torch.Tensor:
    """Average brightness (H, W) over 3 x 3 texels, the centre with four times the weight of an edge neighbour.

    The result is close to the density of least variance under bilinear lookup.
    """
    rows = torch.cat([brightness[:1], brightness, brightness[-1:]])
    rows = (1 - 2 * SIDE) * rows[1:-1] + SIDE * (rows[:-2] + rows[2:])
    return (1 - 2 * SIDE) * rows + SIDE * (rows.roll(1, 1) + rows.roll(-1, 1))
