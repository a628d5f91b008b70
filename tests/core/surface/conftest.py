# SPDX-License-Identifier: GPL-3.0-or-later
"""Analytic solids and their G-buffers: ground truth everywhere."""

from collections.abc import Callable
from dataclasses import dataclass, field
from functools import partial

import numpy as np
import pytest
from irgspp.core.scene.camera import Camera
from irgspp.core.scene.dataset import Bound
from irgspp.core.scene.gbuffer import GBuffer, SurfaceSamples


def colour_of(points: np.ndarray) -> np.ndarray:
    """Return a smooth colour (..., 3) in 0..1 for world points (..., 3)."""
    return 0.5 + 0.4 * np.sin(points * np.array([2.0, 3.0, 2.5]) + np.array([0.0, 1.0, 2.0]))


@dataclass(frozen=True)
class Solid:
    """Solid given by its signed distance function, rendered by sphere tracing."""

    distance: Callable[[np.ndarray], np.ndarray]

    def gradient(self, points: np.ndarray) -> np.ndarray:
        step = 1e-5 * np.eye(3)
        slopes = [self.distance(points + s) - self.distance(points - s) for s in step]
        gradient = np.stack(slopes, -1)
        return gradient / np.linalg.norm(gradient, axis=-1, keepdims=True)

    def project(self, points: np.ndarray) -> np.ndarray:
        """Return the nearest points of the surface."""
        for _ in range(3):
            points = points - self.distance(points)[..., None] * self.gradient(points)
        return points

    def view(self, camera: Camera, depth_noise: float = 0.0, seed: int = 0) -> GBuffer:
        rays = camera.rays().astype(np.float64)
        length = np.linalg.norm(rays, axis=-1)
        direction, along = (rays / length[..., None]).reshape(-1, 3), np.full(length.size, 1.0)
        moving = np.arange(length.size)
        for _ in range(80):
            step = self.distance(camera.centre + along[moving, None] * direction[moving])
            along[moving] = np.minimum(along[moving] + step, 20.0)
            moving = moving[(np.abs(step) > 1e-9) & (along[moving] < 20)]
        along = along.reshape(length.shape)
        hit = along < 19
        points = camera.centre + along[..., None] * rays / length[..., None]
        normal = np.where(hit[..., None], self.gradient(points), 0)
        albedo = np.where(hit[..., None], colour_of(points), 0)
        noise = depth_noise * np.random.default_rng(seed).normal(size=hit.shape)
        layers = hit, np.where(hit, along / length + noise, 0), normal, albedo, albedo
        roughness = np.where(hit, colour_of(points)[..., 1], 0)
        metallic = np.where(hit, colour_of(points)[..., 2], 0)
        return GBuffer(camera, *(x.astype(np.float32) for x in (*layers, roughness, metallic)))

    def samples(self, count: int = 4000) -> SurfaceSamples:
        points = np.random.default_rng(1).uniform(-1.3, 1.3, (20 * count, 3))
        points = self.project(points[np.abs(self.distance(points)) < 0.3][:count])
        colour = colour_of(points)
        layers = points, self.gradient(points), np.full(len(points), 0.9), colour, colour[:, 1], colour[:, 2]
        return SurfaceSamples(*(x.astype(np.float32) for x in layers))


def sphere_distance(points: np.ndarray) -> np.ndarray:
    return np.linalg.norm(points, axis=-1) - 1.0


def torus_distance(points: np.ndarray) -> np.ndarray:
    return np.hypot(np.hypot(points[..., 0], points[..., 1]) - 0.8, points[..., 2]) - 0.35


def box_distance(points: np.ndarray) -> np.ndarray:
    q = np.abs(points) - np.array([0.8, 0.6, 0.5])
    return np.linalg.norm(np.maximum(q, 0), axis=-1) + np.minimum(q.max(-1), 0)


@pytest.fixture(scope="session")
def bound() -> Bound:
    return Bound((0.0, 0.0, 0.0), 1.5)


@pytest.fixture(scope="session")
def solids() -> dict[str, Solid]:
    return {"sphere": Solid(sphere_distance), "torus": Solid(torus_distance), "box": Solid(box_distance)}


@pytest.fixture(scope="session")
def camera_ring(camera_ring) -> Callable[..., list[Camera]]:
    """The shared fixture with finer images and cameras nearer to the poles."""
    return partial(camera_ring, size=96, lowest=-0.95, highest=0.95)


@pytest.fixture(scope="session")
def true_colour() -> Callable[[np.ndarray], np.ndarray]:
    return colour_of


@dataclass
class Recorder:
    """Progress that records phases and steps."""

    cancelled: bool = False
    finish_early: bool = False
    events: list[tuple] = field(default_factory=list)

    def phase(self, name, steps):
        self.events.append((name, steps))

    def step(self, done, **metrics):
        self.events.append((done,))

    def message(self, text):
        pass


@pytest.fixture(scope="session")
def recorder() -> type[Recorder]:
    return Recorder
