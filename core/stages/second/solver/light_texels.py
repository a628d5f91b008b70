# SPDX-License-Identifier: GPL-3.0-or-later
"""Texels of the light that the solver finds: a lat-long map whose texels are split where the light varies strongly.

A lamp or the sun is far smaller than a texel of a coarse map. Spread over a whole texel, it casts soft shadows, and the edges of the real
shadows are left in the albedo. A map that is fine everywhere would cost too much time and leave too many unknowns.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import torch

from ....kernels.constants import PER_STRATUM
from ....shading.environment_lookup import direction_to_uv
from ...common.light_map import resized_light


@dataclass(frozen=True, eq=False)
class LightTexels:
    """T texels that cover the sphere: leaves of quadtrees over a lat-long map.

    Attributes:
        height: rows of the map of the largest texels; it has twice as many columns.
        level: (T,) int64 number of times that a texel has been split; level k belongs to a map of 2^k height rows.
        row: (T,) int64 row in the map of its level.
        column: (T,) int64 column in the map of its level.
    """

    height: int
    level: np.ndarray
    row: np.ndarray
    column: np.ndarray

    @classmethod
    def uniform(cls, height: int) -> LightTexels:
        """Return the texels of a map of `height` rows, row by row."""
        row, column = np.divmod(np.arange(2 * height * height), 2 * height)
        return cls(height, np.zeros_like(row), row, column)

    @property
    def count(self) -> int:
        """Number T of texels."""
        return len(self.level)

    @property
    def finest_height(self) -> int:
        """Rows of the map of the smallest texels."""
        return self.height << int(self.level.max())

    @cached_property
    def solid_angles(self) -> np.ndarray:
        """(T,) float64 solid angles in steradians."""
        rows = self.height << self.level
        return (np.cos(self.row * np.pi / rows) - np.cos((self.row + 1) * np.pi / rows)) * (np.pi / rows)

    def directions(self, side: int, seed: int) -> tuple[np.ndarray, np.ndarray]:
        """Draw one direction in each of side x side strata of every texel.

        Args:
            side: strata along a side of a texel.
            seed: seed of the random positions within the strata.

        Returns:
            Unit directions (3, D) and solid angles (D,) in steradians, float32, D = side^2 T; texels run fastest.
        """
        random = np.random.default_rng(seed)
        parts = []
        for i in range(side):
            for j in range(side):
                down, across = (i + random.random(self.count)) / side, (j + random.random(self.count)) / side
                parts.append(self._directions(down, across))
        angle = (self.solid_angles / side**2).astype(np.float32)
        return np.concatenate(parts, 1).astype(np.float32), np.tile(angle, side**2)

    def strata(self, side: int) -> np.ndarray:
        """Return PER_STRATUM directions evenly spread over each of the strata of `directions`: (D, 3, PER_STRATUM) float32 unit."""
        fine = math.isqrt(PER_STRATUM)
        parts = []
        for i, j in np.ndindex(side, side):
            places = [((i + (a + 0.5) / fine) / side, (j + (b + 0.5) / fine) / side) for a, b in np.ndindex(fine, fine)]
            parts.append(np.stack([self._directions(down, across).T for down, across in places], 2))
        return np.concatenate(parts).astype(np.float32)

    def _directions(self, down: np.ndarray | float, across: np.ndarray | float) -> np.ndarray:
        """Return the unit directions (3, T) of places in the texels, 0..1 from the top and from the left by equal solid angles."""
        rows = self.height << self.level
        top, bottom = np.cos(self.row * (math.pi / rows)), np.cos((self.row + 1) * (math.pi / rows))
        z, phi = top + (bottom - top) * down, math.pi - (self.column + across) * (math.pi / rows)
        r = np.sqrt(1 - z * z)
        return np.stack([r * np.cos(phi), r * np.sin(phi), z])

    def containing(self, direction: np.ndarray) -> np.ndarray:
        """Return the texels (N,) int64 in which directions (N, 3) unit lie."""
        painted = self._painted()
        u, v = (part.numpy() for part in direction_to_uv(torch.from_numpy(direction)))
        row, column = (np.clip((part * size).astype(int), 0, size - 1) for part, size in zip((v, u), painted.shape, strict=True))
        return painted[row, column]

    def split(self, chosen: np.ndarray) -> tuple[LightTexels, LightTexels, np.ndarray]:
        """Split texels into four each.

        Args:
            chosen: (T,) bool.

        Returns:
            All texels, those that were not split first; the new ones alone; and the old texel (T',) in which each of all lies.
        """
        kept, old = np.flatnonzero(~chosen), np.repeat(np.flatnonzero(chosen), 4)
        down, across = np.divmod(np.tile(np.arange(4), len(old) // 4), 2)
        new = LightTexels(self.height, self.level[old] + 1, 2 * self.row[old] + down, 2 * self.column[old] + across)
        joined = (np.concatenate([getattr(self, name)[kept], getattr(new, name)]) for name in ("level", "row", "column"))
        return LightTexels(self.height, *joined), new, np.concatenate([kept, old])

    @cached_property
    def pairs(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Neighbours (N, 2) int64; length of their common edge over the distance of their centres (N,); that distance in radians (N,)."""
        painted, finest = self._painted(), int(self.level.max())
        across = np.stack([painted, np.roll(painted, -1, 1)], -1).reshape(-1, 2)
        down = np.stack([painted[:-1], painted[1:]], -1).reshape(-1, 2)
        touching = np.concatenate([across, down])
        touching = np.sort(touching[touching[:, 0] != touching[:, 1]], 1)
        pairs, edge = np.unique(touching, axis=0, return_counts=True)
        distance = (2.0 ** (finest - self.level))[pairs].mean(1)
        return pairs, edge / distance, distance * (math.pi / len(painted))

    def brightest(self, light: torch.Tensor, rows: int, most: int) -> np.ndarray:
        """Choose texels that are much brighter than a neighbour, by the light that this contrast makes over the whole texel.

        Args:
            light: (T, 3) linear radiance.
            rows: rows of a map whose texels are as small as parts may be.
            most: number of texels; where fewer may be chosen, none is.

        Returns:
            (T,) bool.
        """
        brightness, (one, other) = light.mean(1).double().cpu().numpy(), self.pairs[0].T
        contrast, step = np.zeros(self.count), brightness[one] - brightness[other]
        np.maximum.at(contrast, one, step)
        np.maximum.at(contrast, other, -step)
        large, chosen = 2 * (self.height << self.level) <= rows, np.zeros(self.count, bool)
        if large.sum() >= most:
            chosen[np.argsort(np.where(large, -contrast * self.solid_angles, 1), kind="stable")[:most]] = True
        return chosen

    def with_one_colour(self, light: torch.Tensor) -> torch.Tensor:
        """Give all parts of a split texel the same chromaticity, which single parts do not know well; each channel keeps its sum over them.

        Args:
            light: (T, 3) linear radiance.

        Returns:
            (T, 3).
        """
        if not self.level.any():
            return light
        largest = torch.from_numpy((self.row >> self.level) * 2 * self.height + (self.column >> self.level))
        lies_in = (largest == torch.arange(2 * self.height**2)[:, None]).to(light)
        power = lies_in @ (light * torch.from_numpy(self.solid_angles).to(light)[:, None])
        return light.mean(1, keepdim=True) * (power / power.mean(1, keepdim=True))[largest.to(light.device)]

    def map(self, values: torch.Tensor, height: int) -> torch.Tensor:
        """Interpolate values of the texels to a lat-long map. What lies in split texels does not spread over the larger ones around them.

        Args:
            values: (T, C).
            height: rows of the map, at least those of the finest texels.

        Returns:
            (height, 2 height, C).
        """
        painted = torch.from_numpy(self._painted()).to(values.device)
        level, finest = torch.from_numpy(self.level).to(values.device)[painted], int(self.level.max())
        image = values[painted]
        for k in range(finest + 1):
            size = 2 ** (finest - k)
            own, of_level = values[painted[::size, ::size]], level[::size, ::size]
            image = own if k == 0 else torch.where((of_level == k)[..., None], own, resized_light(image, len(own)))
            image = filled(image, of_level > k)
        return resized_light(image, height)

    def _painted(self) -> np.ndarray:
        """Return the texel (H, 2H) of each place of a map with the rows of the finest level."""
        finest = int(self.level.max())
        painted = np.zeros((self.height << finest, 2 * self.height << finest), np.int64)
        for level in range(finest + 1):
            of_level, size = np.flatnonzero(self.level == level), 2 ** (finest - level)
            rows, columns = (size * part[of_level] for part in (self.row, self.column))
            for i in range(size):
                for j in range(size):
                    painted[rows + i, columns + j] = of_level
        return painted


def filled(image: torch.Tensor, gaps: torch.Tensor) -> torch.Tensor:
    """Fill gaps of a lat-long map with the mean of the known texels next to them, from their edges inwards.

    Args:
        image: (H, W, C).
        gaps: (H, W) bool; where all are gaps, the image stays as it is.

    Returns:
        (H, W, C).
    """
    known = ~gaps
    if not known.any():
        return image
    while not known.all():
        planes = torch.cat([image * known[..., None], known[..., None].to(image)], -1).permute(2, 0, 1)
        around = torch.cat([planes[..., -1:], planes, planes[..., :1]], -1)
        sums = 9 * torch.nn.functional.avg_pool2d(torch.nn.functional.pad(around, (0, 0, 1, 1))[None], 3, stride=1)[0].permute(1, 2, 0)
        reached = ~known & (sums[..., -1] > 0.5)
        image = torch.where(reached[..., None], sums[..., :-1] / sums[..., -1:].clamp_min(1), image)
        known = known | reached
    return image
