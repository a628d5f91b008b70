# SPDX-License-Identifier: GPL-3.0-or-later
"""Environment map: distant light as a rotated lat-long image, in the same convention in Blender and in the engine.

Row 0 is +Z; u = 0.5 - atan2(y, x) / 2 pi, v = acos(z) / pi, texel centres at +0.5. Only numpy is used: the module also runs in
Blender's process. `core/shading/environment_lookup.py` is the same lookup in PyTorch, compared by
`tests/core/shading/test_lightmap_agreement.py`; only here rows wrap around at the poles, as in Cycles.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np


@dataclass(frozen=True, eq=False)
class EnvironmentMap:
    """Radiance from every direction of a world.

    Attributes:
        texels: (H, W, 3) float32 linear radiance, finite and >= 0; (1, 1, 3) is a uniform colour.
        turn: (3, 3) rotation; direction d looks up the texel of turn @ d.
        strength: factor of the radiance, >= 0.
    """

    texels: np.ndarray
    turn: np.ndarray = field(default_factory=lambda: np.eye(3))
    strength: float = 1.0

    def radiance(self, directions: np.ndarray) -> np.ndarray:
        """Return the bilinearly interpolated radiance (..., 3) along directions (..., 3) of any length but 0."""
        if self.texels.shape[:2] == (1, 1):
            return np.broadcast_to(self.texels[0, 0] * np.float32(self.strength), directions.shape).copy()
        seen = _bilinear(self.texels, directions.reshape(-1, 3) @ self.turn.T)
        return (seen * np.float32(self.strength)).reshape(directions.shape)

    def turned(self, rotation: np.ndarray) -> EnvironmentMap:
        """Return the map in another frame, whose directions `rotation` (3, 3) takes to the world's."""
        return replace(self, turn=self.turn @ rotation)

    def image(self, height: int) -> np.ndarray:
        """Resample the map to a lat-long image (height, 2 height, 3) float32, with rotation and strength applied.

        Texels are averaged by their solid angle, so that no light is lost.
        """
        if self.texels.shape[:2] == (1, 1):
            return np.broadcast_to(self.texels[0, 0] * np.float32(self.strength), (height, 2 * height, 3)).copy()
        small = replace(self, texels=reduced(self.texels, self.texels.shape[0] // (2 * height)))
        rows, columns = small.texels.shape[:2]
        finer = max(1, round(rows / height))
        if (rows, columns) == (finer * height, 2 * finer * height) and np.allclose(self.turn, np.eye(3), atol=1e-9):
            return reduced(small.texels, finer) * np.float32(self.strength)
        return reduced(small.radiance(texel_directions(finer * height)), finer)


def reduced(texels: np.ndarray, factor: int) -> np.ndarray:
    """Reduce a lat-long image by averaging blocks of texels, weighted by their solid angle.

    Args:
        texels: (H, W, C).
        factor: side of a block in texels.

    Returns:
        (H / factor, W / factor, C) float32; unchanged (H, W, C) where H or W is not a multiple of the factor.
    """
    height, width, channels = texels.shape
    if factor <= 1 or height % factor or width % factor:
        return np.ascontiguousarray(texels, np.float32)
    blocks = texels.reshape(height // factor, factor, width // factor, factor, channels).mean(3, dtype=np.float64)
    edges = np.cos(np.arange(height + 1) * (np.pi / height))
    angle = (edges[:-1] - edges[1:]).reshape(-1, factor, 1, 1)
    return ((blocks * angle).sum(1) / angle.sum(1)).astype(np.float32)


def texel_directions(height: int) -> np.ndarray:
    """Return the unit directions (height, 2 height, 3) of the texel centres."""
    theta = (np.arange(height) + 0.5) * (np.pi / height)
    phi = np.pi - (np.arange(2 * height) + 0.5) * (np.pi / height)
    sine = np.sin(theta)[:, None]
    up = np.broadcast_to(np.cos(theta)[:, None], (height, 2 * height))
    return np.stack([sine * np.cos(phi), sine * np.sin(phi), up], -1)


def _bilinear(texels: np.ndarray, directions: np.ndarray) -> np.ndarray:
    """Interpolate texels (H, W, 3) along directions (N, 3) to (N, 3), wrapped around in both axes as in Cycles."""
    height, width = texels.shape[:2]
    x, y, z = directions.T
    u = 0.5 - np.arctan2(y, x) / (2 * np.pi)
    v = np.arctan2(np.hypot(x, y), z) / np.pi
    column, row = u * width - 0.5, v * height - 0.5
    left, top = np.floor(column).astype(np.int64), np.floor(row).astype(np.int64)
    s, t = (column - left)[:, None].astype(np.float32), (row - top)[:, None].astype(np.float32)
    flat = texels.reshape(-1, 3)
    rows, columns = (top % height * width, (top + 1) % height * width), (left % width, (left + 1) % width)
    upper = flat[rows[0] + columns[0]] * (1 - s) + flat[rows[0] + columns[1]] * s
    lower = flat[rows[1] + columns[0]] * (1 - s) + flat[rows[1] + columns[1]] * s
    return upper * (1 - t) + lower * t
