# SPDX-License-Identifier: GPL-3.0-or-later
"""The scene of known geometry in each dataset format, and checks of what a reader finds in it."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
import torch
from formats_scene import BALL, RADIUS, render_scene
from irgspp.core.datasets.load import load_dataset, load_novel_views
from irgspp.core.evaluation.ground_truth import SceneTruth, Truth, load_scene_truth, load_truth, rotate_to_frame
from irgspp.core.io.srgb import decode_srgb
from irgspp.core.scene.camera import Camera
from irgspp.core.scene.dataset import Dataset, View
from irgspp.core.settings.schema import DataSettings
from irgspp.core.shading.environment_lookup import lookup
from scripts_folder import scripts_on_path
from shared_folder import shared_folder

with scripts_on_path():
    from formats import WRITERS, realitycapture, stanford_orb
    from formats.source import Shot, Source, load_source, moved_points, placed, similarity

__all__ = [
    "NAMES",
    "RIGHT",
    "SEVERAL",
    "Written",
    "every",
    "mirror_errors",
    "moved_points",
    "realitycapture",
    "similarity",
    "source",
    "stanford_orb",
    "truths_of",
]

NAMES = sorted(WRITERS)
BLOCK, REACH = np.array([-0.5, 0.35, -0.35]), 0.6  # a sphere around the block, whose reflection does not show the light
TINT = np.array([0.9, 0.85, 0.8])
SEVERAL = DataSettings(holdout=4)
RIGHT = 0.06  # relative difference; the ball is not a perfect mirror: measured at most 0.04 in a view


@dataclass(frozen=True, eq=False)
class Written:
    """Written dataset: its path, and the similarity (4, 4) from the scene's world to the dataset's own frame."""

    path: Path
    world: np.ndarray
    source: Source

    @classmethod
    def of(cls, name: str, source: Source, folder: Path) -> Written:
        return cls(*WRITERS[name](source, folder), source)

    @property
    def shots(self) -> list[Shot]:
        return [*self.source.train, *self.source.test]

    def shot_of(self, pose: np.ndarray, to_world: np.ndarray) -> tuple[Shot, float]:
        """Return the shot whose true pose is closest to a pose (4, 4), and the largest difference in units of the scene."""
        size = float(np.cbrt(np.linalg.det((to_world @ self.world)[:3, :3])))
        truths = [placed(to_world @ self.world, s.pose) for s in self.shots]
        errors = [max(np.abs(t[:3, :3] - pose[:3, :3]).max(), np.abs(t[:3, 3] - pose[:3, 3]).max() / size) for t in truths]
        return self.shots[int(np.argmin(errors))], float(min(errors))

    def ball(self, to_world: np.ndarray) -> tuple[np.ndarray, float]:
        """Return centre (3,) and radius of the ball in the normalised world."""
        return _moved(to_world @ self.world, BALL), RADIUS * float(np.cbrt(np.linalg.det((to_world @ self.world)[:3, :3])))

    def mirror_error(self, camera: Camera, alpha: np.ndarray | None, image: np.ndarray, light: np.ndarray, to_world: np.ndarray) -> float:
        """Return the mean relative difference of an sRGB image (H, W, 3) and a light (H', W', 3) reflected in the ball."""
        centre, radius = self.ball(to_world)
        block = _moved(to_world @ self.world, BLOCK)
        ray = camera.rays().astype(np.float64)
        ray /= np.linalg.norm(ray, axis=-1, keepdims=True)
        distance = _hit(np.broadcast_to(camera.centre, ray.shape), ray, centre, radius)
        hit = camera.centre + np.where(np.isfinite(distance), distance, 0)[..., None] * ray
        normal = (hit - centre) / radius
        cosine = -(ray * normal).sum(-1)
        reflected = ray + 2 * cosine[..., None] * normal
        reach = REACH * radius / RADIUS
        clear = np.isinf(_hit(np.broadcast_to(camera.centre, ray.shape), ray, block, reach)) & np.isinf(_hit(hit, reflected, block, reach))
        chosen = np.isfinite(distance) & clear & (cosine > 0.35) & (True if alpha is None else alpha > 0.99)
        assert chosen.sum() > 40
        seen = decode_srgb(np.clip(image[chosen], 0, 1).astype(np.float64))
        expected = np.clip(lookup(torch.from_numpy(light).double(), torch.from_numpy(reflected[chosen])).numpy() * TINT, 0, 1)
        return float(np.abs(seen - expected).mean() / seen.mean())


@pytest.fixture(scope="session")
def source(tmp_path_factory: pytest.TempPathFactory) -> Source:
    """Return the scene, rendered once for all processes of the tests."""
    return load_source(render_scene(shared_folder(tmp_path_factory) / "formats_scene"))


@pytest.fixture(scope="session")
def every(source: Source, tmp_path_factory: pytest.TempPathFactory) -> dict[str, Written]:
    """Write the scene in each format and return the datasets by the formats' names."""
    return {name: Written.of(name, source, tmp_path_factory.mktemp(name)) for name in NAMES}


def truths_of(dataset: Written) -> tuple[Dataset, SceneTruth, list[tuple[View, Truth]]]:
    """Return the dataset as read, the scene's ground truth, and each test view and novel view with its ground truth."""
    data = load_dataset(dataset.path)
    scene = load_scene_truth(dataset.path, data.to_world)
    views = [*data.test, *load_novel_views(data, DataSettings())]
    return data, scene, [(view, load_truth(view, scene, data.to_world)) for view in views]


def mirror_errors(light: np.ndarray) -> Iterator[tuple[str, np.ndarray]]:
    """Yield descriptions and copies of the light with each common confusion of axes: rotations and reflections."""
    quarter = light.shape[1] // 4
    for turns in (1, 2, 3):
        yield f"turned by {turns} quarters", np.roll(light, turns * quarter, 1)
    yield "mirrored", light[:, ::-1].copy()
    yield "mirrored and turned", np.roll(light[:, ::-1], quarter, 1).copy()
    yield "upside down", light[::-1].copy()
    yield "on its side", _on_its_side(light)


def _on_its_side(light: np.ndarray) -> np.ndarray:
    """Return the light as if +Y up had been mistaken for +Z up."""
    return rotate_to_frame(light, np.array([[1.0, 0, 0, 0], [0, 0, -1, 0], [0, 1, 0, 0], [0, 0, 0, 1]]))


def _moved(world: np.ndarray, point: Sequence[float] | np.ndarray) -> np.ndarray:
    return world[:3, :3] @ np.asarray(point) + world[:3, 3]


def _hit(origin: np.ndarray, ray: np.ndarray, centre: np.ndarray, radius: float) -> np.ndarray:
    """Return the distance along unit rays (..., 3) to a ball, infinite for rays that miss it or point away."""
    towards = origin - centre
    b, c = (ray * towards).sum(-1), (towards**2).sum(-1) - radius**2
    under = b * b - c
    distance = -b - np.sqrt(np.maximum(under, 0))
    return np.where((under > 0) & (distance > 1e-9), distance, np.inf)
