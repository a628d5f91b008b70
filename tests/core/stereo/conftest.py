# SPDX-License-Identifier: GPL-3.0-or-later
"""Analytic scenes with a solid texture: a sphere and a slanted plane, their exact depth and normals, and the views of an arc of cameras."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
from irgspp.core.scene.camera import Camera, look_at
from irgspp.core.scene.dataset import View

SIZE = 64
_draw = np.random.default_rng(5)
_direction = _draw.normal(size=(3, 24))
WAVES = _direction / np.linalg.norm(_direction, axis=0) * _draw.uniform(8, 28, 24)  # wavelengths from 4 to 14 pixels
PHASES = _draw.uniform(0, 2 * np.pi, 24)
PLANE_NORMAL = np.array([0.45, 0.2, 0.87]) / np.linalg.norm([0.45, 0.2, 0.87])


def texture(points: np.ndarray) -> np.ndarray:
    """Grey values (...,) for points (..., 3)."""
    return 0.5 + 0.08 * np.sin(points @ WAVES + PHASES).sum(-1)


@dataclass(frozen=True, eq=False)
class Scene:
    """Views of a solid, with exact depth and normals (0 where a ray misses)."""

    views: list[View]
    depth: list[np.ndarray]
    normal: list[np.ndarray]


def sphere_hit(origin: np.ndarray, ray: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Hits of the unit sphere: flag, parameter along the ray, normal."""
    a, b, c = (ray * ray).sum(-1), (ray * origin).sum(-1), origin @ origin - 1
    inside = b * b - a * c
    t = (-b - np.sqrt(np.maximum(inside, 0))) / a
    return inside > 0, t, origin + t[..., None] * ray


def plane_hit(origin: np.ndarray, ray: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Hits of a slanted plane through the origin."""
    t = -(origin @ PLANE_NORMAL) / (ray @ PLANE_NORMAL)
    return t > 0, t, np.broadcast_to(PLANE_NORMAL, ray.shape)


def arc(count: int = 6, distance: float = 4.0, size: int = SIZE) -> list[Camera]:
    """Cameras 12 degrees apart, some higher than others, that look at the origin from above."""
    angle = np.radians(12.0 * (np.arange(count) - (count - 1) / 2))
    tilt = np.radians(np.where(np.arange(count) % 2, 8.0, -8.0))
    places = distance * np.stack([np.sin(angle) * np.cos(tilt), np.sin(tilt), np.cos(angle) * np.cos(tilt)], -1)
    return [Camera(size, size, 1.3 * size, 1.3 * size, size / 2, size / 2, look_at(p, up=(0, 1, 0))) for p in places]


def photographed(hit: Callable, cameras: list[Camera], shade: Callable = texture, masked: bool = False) -> Scene:
    """Render a solid with 3 x 3 samples a pixel, on black."""
    scene = Scene([], [], [])
    for i, camera in enumerate(cameras):
        fine = camera.resized(3 * camera.width, 3 * camera.height).rays().astype(np.float64)
        seen, t, _ = hit(camera.centre, fine)
        values = np.where(seen, shade(camera.centre + t[..., None] * fine), 0)
        grey, alpha = (a.reshape(camera.height, 3, camera.width, 3).mean((1, 3)) for a in (values, seen.astype(float)))
        grey = np.where(alpha > 0, grey / np.maximum(alpha, 1e-9), 0) if masked else grey
        colour = np.repeat(grey[..., None], 3, -1).astype(np.float32)
        scene.views.append(View(f"{i}", camera, Path(f"{i}.png"), colour, alpha.astype(np.float32) if masked else None))
        seen, t, normal = hit(camera.centre, camera.rays().astype(np.float64))
        scene.depth.append(np.where(seen, t, 0))
        scene.normal.append(np.where(seen[..., None], normal, 0))
    return scene


@pytest.fixture(scope="session")
def sphere() -> Scene:
    return photographed(sphere_hit, arc(), masked=True)


@pytest.fixture(scope="session")
def plane() -> Scene:
    return photographed(plane_hit, arc())


@pytest.fixture(scope="session")
def flat_plane() -> Scene:
    return photographed(plane_hit, arc(), lambda points: np.full(points.shape[:-1], 0.5))


@pytest.fixture(scope="session")
def shaded_sphere() -> Scene:
    """Sphere without texture whose brightness tells the place on it, in steps of 8 bits."""
    return photographed(sphere_hit, arc(), lambda points: np.round(255 * (0.45 + 0.25 * points @ [0.5, 0.7, 0.5])) / 255, masked=True)


@pytest.fixture(scope="session")
def camera_arc() -> Callable[..., list[Camera]]:
    return arc
