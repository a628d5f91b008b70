# SPDX-License-Identifier: GPL-3.0-or-later
"""Rendered photographs of boxes and spheres on a table, with exact masks: solid textures, cameras around, no shading."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from irgspp.core.scene.camera import Camera, look_at
from irgspp.core.scene.dataset import PointCloud, View

HORIZON = np.array([0.55, 0.6, 0.66])
_draw = np.random.default_rng(11)
_direction = _draw.normal(size=(3, 20))
WAVES = _direction / np.linalg.norm(_direction, axis=0) * _draw.uniform(12, 34, 20)
PHASES = _draw.uniform(0, 2 * np.pi, 20)
FINE = 2  # samples along a pixel's side


@dataclass(frozen=True)
class Solid:
    """Box (half sizes) or sphere (a radius) with a base colour."""

    centre: tuple[float, float, float]
    size: tuple[float, ...]
    base: tuple[float, float, float]

    def hit(self, origin: np.ndarray, rays: np.ndarray) -> np.ndarray:
        """Distances (...,) along rays (..., 3), infinite where they miss."""
        start = origin - np.array(self.centre)
        if len(self.size) == 1:
            a, b, c = (rays * rays).sum(-1), rays @ start, start @ start - self.size[0] ** 2
            inside = b * b - a * c
            return np.where(inside > 0, (-b - np.sqrt(np.maximum(inside, 0))) / a, np.inf)
        low, high = ((sign * np.array(self.size) - start) / rays for sign in (-1, 1))
        enter, leave = np.minimum(low, high).max(-1), np.maximum(low, high).min(-1)
        return np.where((enter < leave) & (enter > 0), enter, np.inf)

    def surface(self, count: int, rng: np.random.Generator) -> np.ndarray:
        """Points (count, 3) on the surface."""
        point = rng.normal(size=(count, 3))
        if len(self.size) == 1:
            return np.array(self.centre) + self.size[0] * point / np.linalg.norm(point, axis=1, keepdims=True)
        point = rng.uniform(-1, 1, (count, 3))
        axis = rng.integers(0, 3, count)
        point[np.arange(count), axis] = np.sign(point[np.arange(count), axis])
        return np.array(self.centre) + point * self.size


OBJECT = Solid((0.0, 0.0, 0.5), (0.32, 0.24, 0.5), (0.3, 0.55, 0.35))
CLUTTER = Solid((1.15, 0.55, 0.2), (0.22, 0.2, 0.2), (0.35, 0.35, 0.65))
TABLE = (0.62, 0.45, 0.3)


@dataclass
class TableScene:
    """Photographs of solids on the table z = 0, of which the first is the object, with its masks by view name."""

    views: list[View] = field(default_factory=list)
    points: PointCloud | None = None
    masks: dict[str, np.ndarray] = field(default_factory=dict)


def photographed_table(
    solids: tuple[Solid, ...] = (OBJECT, CLUTTER),
    count: int = 12,
    width: int = 160,
    table: bool = True,
    target: tuple[float, float, float] = (0.0, 0.0, 0.4),
    step: float | None = None,
) -> TableScene:
    """Render the solids from cameras around a point, high and low in turn, `step` degrees apart (None: all around)."""
    scene, rng = TableScene(), np.random.default_rng(3)
    height = 3 * width // 4
    for i in range(count):
        angle, tilt = np.radians(i * (360 / count if step is None else step)), np.radians(28 if i % 2 else 42)
        eye = np.array(target) + 3.6 * np.array([np.cos(angle) * np.cos(tilt), np.sin(angle) * np.cos(tilt), np.sin(tilt)])
        camera = Camera(width, height, 1.1 * width, 1.1 * width, width / 2, height / 2, look_at(eye, target))
        colour, mask = _rendered(camera, solids, table)
        noisy = np.clip(colour + rng.normal(0, 0.008, colour.shape), 0, 1).astype(np.float32)
        scene.views.append(View(f"view{i:02d}", camera, Path(f"view{i:02d}.png"), noisy, None))
        scene.masks[f"view{i:02d}"] = mask
    seen = [solid.surface(80, rng) for solid in solids]
    if table:
        seen.append(np.concatenate([rng.uniform(-2, 2, (300, 2)), np.zeros((300, 1))], 1))
    position = np.concatenate(seen).astype(np.float32)
    scene.points = PointCloud(position, np.full_like(position, 0.5))
    return scene


def _rendered(camera: Camera, solids: tuple[Solid, ...], table: bool) -> tuple[np.ndarray, np.ndarray]:
    """Colours (H, W, 3) and the first solid's coverage (H, W)."""
    rays = camera.resized(FINE * camera.width, FINE * camera.height).rays().astype(np.float64)
    down = np.where(rays[..., 2] < -1e-6, -camera.centre[2] / np.minimum(rays[..., 2], -1e-6), np.inf)
    hits = [*(solid.hit(camera.centre, rays) for solid in solids), down if table else np.full_like(down, np.inf)]
    nearest = np.argmin(hits, 0)
    far = np.min(hits, 0)
    place = camera.centre + np.where(np.isfinite(far), far, 0)[..., None] * rays
    grey = 0.07 * np.sin(place @ WAVES + PHASES).sum(-1, keepdims=True)
    base = np.array([*(solid.base for solid in solids), TABLE])[nearest]
    colour = np.where(np.isfinite(far)[..., None], np.clip(base + grey, 0.02, 0.98), HORIZON)
    own = (nearest == 0) & np.isfinite(far)
    pixels = (camera.height, FINE, camera.width, FINE)
    return colour.reshape(*pixels, 3).mean((1, 3)), own.reshape(pixels).mean((1, 3)).astype(np.float32)
