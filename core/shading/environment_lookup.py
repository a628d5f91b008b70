# SPDX-License-Identifier: GPL-3.0-or-later
"""Lat-long light maps: the one place that knows which texel a direction sees.

Row 0 is +Z; u = 0.5 - atan2(y, x) / 2 pi, v = acos(z) / pi, texel centres at +0.5: Blender's equirectangular World.
"""

from __future__ import annotations

import math

import numpy as np
import torch

from ..machine.backend import by_warp

POLE = 0.995  # height from which it says too little of the angle in float32, where rows of an 8k map are narrower than what it rounds to


def direction_to_uv(direction: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
    """(..., 3) unit directions to u, v (...) in 0..1."""
    x, y, z = direction.unbind(-1)
    # Exactly at a pole atan2 has no slope; a nudge keeps the gradient finite and moves the texel by nothing.
    x = torch.where((x.abs() < 1e-6) & (y.abs() < 1e-6), torch.full_like(x, 1e-6), x)
    polar, near = torch.acos(z.clamp(-1 + 1e-6, 1 - 1e-6)), z.abs() > POLE
    if by_warp(z):  # which directions are near would have to be waited for
        sine = torch.asin((x * x + y * y).clamp(1e-30, 1 - 1e-6).sqrt())
        polar = torch.where(near, torch.where(z > 0, sine, math.pi - sine), polar)
    elif near.any():
        sine = torch.asin((x[near] ** 2 + y[near] ** 2).sqrt())
        polar = polar.masked_scatter(near, torch.where(z[near] > 0, sine, math.pi - sine))
    return 0.5 - torch.atan2(y, x) / (2 * math.pi), polar / math.pi


def texel_directions(height: int, width: int, dtype: torch.dtype = torch.float32) -> torch.Tensor:
    """(H, W, 3) unit directions of the texel centres."""
    theta = (torch.arange(height, dtype=dtype) + 0.5) * (math.pi / height)
    phi = math.pi - (torch.arange(width, dtype=dtype) + 0.5) * (2 * math.pi / width)
    s, c = theta.sin()[:, None].expand(height, width), theta.cos()[:, None].expand(height, width)
    return torch.stack([s * phi.cos(), s * phi.sin(), c], -1)


def solid_angles(height: int, width: int, dtype: torch.dtype = torch.float32) -> torch.Tensor:
    """(H,) exact solid angle of a texel in each row; they sum to 4 pi over the map."""
    edges = torch.cos(torch.arange(height + 1, dtype=dtype) * (math.pi / height))
    return (edges[:-1] - edges[1:]) * (2 * math.pi / width)


def lookup(maps: torch.Tensor, direction: torch.Tensor, level: torch.Tensor | None = None) -> torch.Tensor:
    """Interpolated values of a light map, or of a stack of them, in directions.

    Args:
        maps: (H, W, C), or (L, H, W, C) with `level`.
        direction: (P, 3) unit.
        level: (P,) fractional index into the stack, 0..L-1.

    Returns:
        (P, C); bilinear, wrapped in u, trilinear with `level`. Differentiable in all arguments.
    """
    stack = maps if maps.ndim == 4 else maps[None]
    levels, _, width, _ = stack.shape
    planes = torch.cat([stack[:, :, -1:], stack, stack[:, :, :1]], 2).permute(3, 0, 1, 2)
    u, v = direction_to_uv(direction)
    coordinates = [(u * width + 1) / (width + 2), v]  # one texel of wrap on either side
    if level is None:
        planes, shape = planes[:, 0], (1, 1, -1, 2)  # torch has a quicker way in two dimensions
    else:
        coordinates.append((level + 0.5) / levels)
        shape = (1, 1, 1, -1, 3)
    grid = (torch.stack(coordinates, -1) * 2 - 1).view(shape)
    values = torch.nn.functional.grid_sample(planes[None], grid, mode="bilinear", padding_mode="border", align_corners=False)
    return values.view(planes.shape[0], -1).T


def rotate(image: np.ndarray, degrees: float) -> np.ndarray:
    """A lat-long map (H, W, C) turned counter-clockwise about +Z; between columns it is interpolated, so that no light is lost."""
    shift = degrees / 360 * image.shape[1]  # u falls with the azimuth: what was at column j + shift comes to j
    whole = int(np.floor(shift))
    share = shift - whole
    return (1 - share) * np.roll(image, -whole, 1) + share * np.roll(image, -whole - 1, 1)
