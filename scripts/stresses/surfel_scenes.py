# SPDX-License-Identifier: GPL-3.0-or-later
"""Random surfels, and cameras and rays that see them."""

from __future__ import annotations

import math

import numpy as np
import torch
from irgspp.core.scene.camera import Camera, look_at

GEOMETRY = ("position", "quaternion", "log_scale", "opacity")

Surfels = dict[str, torch.Tensor]
Rays = tuple[torch.Tensor, torch.Tensor]


def cloud(count: int, seed: int = 0, size: float = 0.12) -> Surfels:
    """Return surfels of any orientation in a ball of radius about 1, with opacity logits around 0.

    Args:
        count: number of surfels.
        seed: seed of the random numbers.
        size: scale of the surfels.
    """
    g = torch.Generator().manual_seed(seed)
    random = lambda *shape: torch.randn(*shape, generator=g)  # noqa: E731
    geometry = (random(3, count) * 0.5, random(4, count), math.log(size) + 0.3 * random(2, count), 1.5 * random(count))
    rest = {"sh": 0.3 * random(16, 3, count), "extra": torch.rand(2, count, generator=g)}
    return dict(zip(GEOMETRY, geometry, strict=True)) | rest


def camera(size: int = 24, eye: tuple[float, float, float] = (3.0, 1.25, 2.0), target: tuple[float, float, float] = (0, 0, 0)) -> Camera:
    """Return a camera of size x size pixels.

    Args:
        size: pixels along a side.
        eye: position, which float32 must represent exactly because the kernels see it so.
        target: point in the middle of the image.
    """
    return Camera(size, size, 1.3 * size, 1.3 * size, size / 2, size / 2, look_at(eye, target))


def scattered(count: int, seed: int = 0, spread: float = 0.7) -> Rays:
    """Return rays in all directions from points in and around the cloud.

    Args:
        count: number of rays.
        seed: seed of the random numbers.
        spread: standard deviation of the origins.

    Returns:
        Origins and directions (count, 3).
    """
    g = torch.Generator().manual_seed(seed)
    direction = torch.nn.functional.normalize(torch.randn(count, 3, generator=g), dim=1)
    return spread * torch.randn(count, 3, generator=g), direction


def towards(eye: np.ndarray, points: torch.Tensor) -> Rays:
    """Return rays from one point through others.

    Args:
        eye: (3,).
        points: (R, 3).

    Returns:
        Origins and directions (R, 3).
    """
    origin = torch.as_tensor(eye, dtype=torch.float32).expand(len(points), 3).contiguous()
    return origin, torch.nn.functional.normalize(points.float() - origin, dim=1)


def aimed(values: Surfels, distance: float) -> Rays:
    """Return two rays at every surfel from around it: at the centre, so that the smallest is hit, and a little off it.

    Args:
        values: 24 surfels.
        distance: distance of the origins.

    Returns:
        Origins and directions (48, 3).
    """
    g = torch.Generator().manual_seed(5)
    points, away = values["position"].T.repeat(2, 1), torch.nn.functional.normalize(torch.randn(2 * 24, 3, generator=g), dim=1)
    origin = points + distance * away
    aside = 0.05 * distance * torch.randn(2 * 24, 3, generator=g)
    return origin, torch.nn.functional.normalize(points - origin + aside, dim=1)


def quaternions_of(normal: torch.Tensor) -> torch.Tensor:
    """Return quaternions (4, N) that rotate +Z to normals (3, N)."""
    unit = torch.nn.functional.normalize(normal, dim=0)
    return torch.stack([1 + unit[2], -unit[1], unit[0], torch.zeros_like(unit[0])])
