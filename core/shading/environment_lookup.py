# SPDX-License-Identifier: GPL-3.0-or-later
"""Lat-long light maps in PyTorch: differentiable bilinear lookup, texel directions, solid angles.

Row 0 is +Z; u = 0.5 - atan2(y, x) / 2 pi, v = acos(z) / pi, texel centres at +0.5: Blender's equirectangular World.

The same mapping exists in numpy without torch for Blender's process (`core/scene/environment_map.py`), in numba for the kernels
(`core/kernels/cpu/directions.py`, `gathering.py`) and in Warp; `tests/core/shading/test_lightmap_agreement.py` compares them.
"""

from __future__ import annotations

import math

import numpy as np
import torch

from ..machine.backend import by_warp

POLE = 0.995  # |z| above which acos(z) is too inaccurate in float32: its rounding error exceeds the rows of an 8k map


def direction_to_uv(direction: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
    """Return the coordinates u and v, (...,) each in 0..1, of unit directions (..., 3)."""
    if direction.dtype == torch.float32 and by_warp(direction) and not (direction.requires_grad and torch.is_grad_enabled()):
        from ..kernels.warp.map_places import lightmap_places  # Warp is an optional dependency

        u, v = lightmap_places(direction)
        return u, v
    x, y, z = direction.unbind(-1)
    # Exactly at a pole atan2 has no gradient; a tiny offset keeps it finite and does not change the texel.
    x = torch.where((x.abs() < 1e-6) & (y.abs() < 1e-6), torch.full_like(x, 1e-6), x)
    polar, near = torch.acos(z.clamp(-1 + 1e-6, 1 - 1e-6)), z.abs() > POLE
    if by_warp(z):  # selecting the directions near a pole would wait for the GPU
        sine = torch.asin((x * x + y * y).clamp(1e-30, 1 - 1e-6).sqrt())
        polar = torch.where(near, torch.where(z > 0, sine, math.pi - sine), polar)
    elif near.any():
        sine = torch.asin((x[near] ** 2 + y[near] ** 2).sqrt())
        polar = polar.masked_scatter(near, torch.where(z[near] > 0, sine, math.pi - sine))
    return 0.5 - torch.atan2(y, x) / (2 * math.pi), polar / math.pi


def to_light_frame(direction: torch.Tensor, rotation: torch.Tensor | None) -> torch.Tensor:
    """Rotate world directions into the frame of a light that has turned relative to the object.

    All light that moves is looked up this way: normal and view are rotated into the light's frame and shading is done there; rays that
    the object may block are rotated back by `from_light_frame`.

    Args:
        direction: (P, 3) world.
        rotation: world to light's frame, (3, 3) or one of each direction (P, 3, 3); None where the light stands still.

    Returns:
        (P, 3) in the light's frame; `direction` itself without a rotation.
    """
    if rotation is None:
        return direction
    return direction @ rotation.T if rotation.ndim == 2 else torch.einsum("pij,pj->pi", rotation, direction)


def from_light_frame(direction: torch.Tensor, rotation: torch.Tensor | None) -> torch.Tensor:
    """Rotate directions from the light's frame to the world; the inverse of `to_light_frame`, with the same arguments."""
    return to_light_frame(direction, None if rotation is None else rotation.mT)


def texel_directions(height: int, width: int, dtype: torch.dtype = torch.float32) -> torch.Tensor:
    """Return the unit directions of the texel centres, (H, W, 3).

    Args:
        height: rows of the map.
        width: columns of the map.
        dtype: floating type of the computation and of the result.
    """
    theta = (torch.arange(height, dtype=dtype) + 0.5) * (math.pi / height)
    phi = math.pi - (torch.arange(width, dtype=dtype) + 0.5) * (2 * math.pi / width)
    s, c = theta.sin()[:, None].expand(height, width), theta.cos()[:, None].expand(height, width)
    return torch.stack([s * phi.cos(), s * phi.sin(), c], -1)


def solid_angles(height: int, width: int, dtype: torch.dtype = torch.float32, device: torch.device | str = "cpu") -> torch.Tensor:
    """Return the exact solid angle in steradians of a texel in each row, (H,); over the map they sum to 4 pi.

    Args:
        height: rows of the map.
        width: columns of the map.
        dtype: floating type of the computation and of the result.
        device: device of the result.
    """
    edges = torch.cos(torch.arange(height + 1, dtype=dtype, device=device) * (math.pi / height))
    return (edges[:-1] - edges[1:]) * (2 * math.pi / width)


def lookup(maps: torch.Tensor, direction: torch.Tensor, level: torch.Tensor | None = None) -> torch.Tensor:
    """Interpolate a light map, or a stack of them, in given directions.

    Args:
        maps: (H, W, C), or (L, H, W, C) with `level`.
        direction: (P, 3) unit.
        level: (P,) fractional index into the stack, 0..L-1.

    Returns:
        (P, C): bilinear, wrapped in u, clamped in v, trilinear with `level`. Differentiable with respect to all arguments.
    """
    return lookup_at(maps, *direction_to_uv(direction), level)


def lookup_at(maps: torch.Tensor, u: torch.Tensor, v: torch.Tensor, level: torch.Tensor | None = None) -> torch.Tensor:
    """Interpolate like `lookup` at coordinates u and v, (P,) each in 0..1."""
    stack = maps if maps.ndim == 4 else maps[None]
    levels, _, width, _ = stack.shape
    planes = torch.cat([stack[:, :, -1:], stack, stack[:, :, :1]], 2).permute(3, 0, 1, 2)
    coordinates = [(u * width + 1) / (width + 2), v]  # one texel of wrap-around on either side
    if level is None:
        planes, shape = planes[:, 0], (1, 1, -1, 2)  # torch is faster in two dimensions
    else:
        coordinates.append((level + 0.5) / levels)
        shape = (1, 1, 1, -1, 3)
    grid = (torch.stack(coordinates, -1) * 2 - 1).view(shape)
    values = torch.nn.functional.grid_sample(planes[None], grid, mode="bilinear", padding_mode="border", align_corners=False)
    return values.view(planes.shape[0], -1).T


def turned(light: np.ndarray, rotation: np.ndarray) -> np.ndarray:
    """Resample a lat-long map in another frame: its radiance in a direction d is that of `light` in the direction `rotation` d.

    Args:
        light: (H, W, 3) map.
        rotation: (3, 3) from the new frame to that of `light`, such as a view's `light_rotation`.

    Returns:
        (H, W, 3) map; `light` itself without a turn.
    """
    if np.allclose(rotation, np.eye(3), atol=1e-7):
        return light
    height, width = light.shape[:2]
    direction = to_light_frame(texel_directions(height, width, torch.float64).reshape(-1, 3), torch.from_numpy(rotation))
    return lookup(torch.from_numpy(light), direction.float()).reshape(light.shape).numpy()


def rotate(image: np.ndarray, degrees: float) -> np.ndarray:
    """Rotate a lat-long map about +Z; columns are interpolated, which keeps the total light.

    Args:
        image: (H, W, C) map.
        degrees: angle, counter-clockwise seen from above.

    Returns:
        (H, W, C) rotated map.
    """
    shift = degrees / 360 * image.shape[1]  # u decreases with the azimuth: column j + shift moves to column j
    whole = int(np.floor(shift))
    fraction = shift - whole
    return (1 - fraction) * np.roll(image, -whole, 1) + fraction * np.roll(image, -whole - 1, 1)
