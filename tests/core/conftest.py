# SPDX-License-Identifier: GPL-3.0-or-later
"""A unit sphere, photographed with exact masks and covered with splats; and both backends: numba, and warp in its place."""

from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest
import torch
from irgspp.core.machine.backend import warp_on_cpu
from irgspp.core.scene.camera import Camera
from irgspp.core.scene.dataset import Bound, Dataset, PointCloud, View
from irgspp.core.scene.gaussians import Gaussians
from irgspp.core.stages.first.initialization import surfels

BOUND = Bound((0.0, 0.0, 0.0), 1.5)


def sphere_mask(camera: Camera, samples: int = 4) -> np.ndarray:
    """(H, W) share of each pixel that the unit sphere covers."""
    rays = camera.resized(samples * camera.width, samples * camera.height).rays().astype(np.float64)
    rays /= np.linalg.norm(rays, axis=-1, keepdims=True)
    along = -(rays @ camera.centre)
    hit = camera.centre @ camera.centre - along**2 < 1
    return hit.reshape(camera.height, samples, camera.width, samples).mean((1, 3)).astype(np.float32)


def photographs(cameras: list[Camera], masked: bool = True, points: PointCloud | None = None) -> Dataset:
    """The sphere in one encoded colour."""
    colour = np.array([0.8, 0.5, 0.2], np.float32)
    views = []
    for i, camera in enumerate(cameras):
        image = np.broadcast_to(colour, (camera.height, camera.width, 3)).copy()
        views.append(View(f"{i}", camera, Path(f"{i}.png"), image, sphere_mask(camera) if masked else None))
    return Dataset(Path("sphere"), "transforms", views, [], BOUND, np.eye(4), points)


def sphere_points(count: int) -> np.ndarray:
    """(N, 3) evenly spread over the unit sphere."""
    z, angle = 1 - 2 * (np.arange(count) + 0.5) / count, np.arange(count) * 2.39996322972865
    r = np.sqrt(1 - z**2)
    return np.stack([r * np.cos(angle), r * np.sin(angle), z], -1)


def splats(count: int, colour: np.ndarray | None = None, opacity: float = 0.95) -> Gaussians:
    """The unit sphere as surfels, radiance `colour` (N, 3)."""
    points = sphere_points(count)
    shown = np.full((count, 3), 0.5) if colour is None else colour
    return surfels(points, points, shown, np.full(count, np.sqrt(4 * np.pi / count)), opacity)


def random_gaussians(count: int, seed: int) -> Gaussians:
    """Anything, anywhere."""
    g = torch.Generator().manual_seed(seed)
    shapes = {"position": (3,), "quaternion": (4,), "log_scale": (2,), "opacity": (), "sh": (16, 3), "material": (5,)}
    return Gaussians(**{name: torch.randn(*shape, count, generator=g) for name, shape in shapes.items()})


@pytest.fixture(scope="session")
def sphere_dataset() -> Callable[..., Dataset]:
    return photographs


@pytest.fixture(scope="session")
def splat_sphere() -> Callable[..., Gaussians]:
    return splats


@pytest.fixture(scope="session")
def some_gaussians() -> Callable[..., Gaussians]:
    return random_gaussians


@pytest.fixture(params=["numba", "warp"])
def engine(request: pytest.FixtureRequest) -> Iterator[str]:
    if request.param == "numba":
        yield request.param
        return
    pytest.importorskip("warp")
    with warp_on_cpu():
        yield request.param
