# SPDX-License-Identifier: GPL-3.0-or-later
"""Normals of surfels that point the wrong way are fitted to a ridged wall."""

from pathlib import Path

import numpy as np
import pytest
import torch
from irgspp.core.kernels.rasterize import rasterize
from irgspp.core.scene.camera import Camera, look_at
from irgspp.core.scene.dataset import View
from irgspp.core.scene.surface import Surface
from irgspp.core.stages.first.initialization import surfels
from irgspp.core.stages.second.normals.normal_fit import fit_rendered_normals
from irgspp.core.surface.normal_images import normal_images
from scipy.ndimage import binary_erosion

SIZE, RIDGES = 48, 10.0


def ridged(points: np.ndarray) -> np.ndarray:
    """Normals (N, 3) of a wall z = 0 with ridges along Y."""
    normals = np.stack([0.2 * np.sin(RIDGES * points[:, 0]), np.zeros(len(points)), np.ones(len(points))], 1)
    return normals / np.linalg.norm(normals, axis=1, keepdims=True)


@pytest.fixture(scope="module")
def wall():
    """Fine mesh of the wall, its views, and surfels on it whose normals are off at random."""
    x, y = (a.ravel() for a in np.meshgrid(np.linspace(-1, 1, 81), np.linspace(-1, 1, 81)))
    vertices = np.stack([x, y, np.zeros_like(x)], 1)
    first = (np.arange(80)[:, None] * 81 + np.arange(80)).ravel()
    faces = np.concatenate([np.stack([first, first + 1, first + 82], 1), np.stack([first, first + 82, first + 81], 1)])
    places = [(0, 0, 3.0), (0.6, 0.3, 2.9), (-0.5, 0.5, 2.9), (0.2, -0.7, 2.9)]
    cameras = [Camera(SIZE, SIZE, 1.2 * SIZE, 1.2 * SIZE, 24, 24, look_at(np.array(p), np.zeros(3), up=(0, 1, 0))) for p in places]
    image, alpha = np.full((SIZE, SIZE, 3), 0.5, np.float32), np.ones((SIZE, SIZE), np.float32)
    views = [View(f"{i}", camera, Path("wall.png"), image, alpha) for i, camera in enumerate(cameras)]
    u, v = (a.ravel() for a in np.meshgrid(np.linspace(-0.95, 0.95, 39), np.linspace(-0.95, 0.95, 39)))
    points = np.stack([u, v, np.zeros_like(u)], 1)
    normals = ridged(points) + 0.15 * np.random.default_rng(0).standard_normal(points.shape)
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    wrong = surfels(points, normals, np.full((len(points), 3), 0.5), np.full(len(points), 0.04), 0.9)
    return Surface(vertices, ridged(vertices), faces, 0.02), views, wrong


def error(gaussians, surface, views):
    """Mean angle in degrees between the rendered normals and the surface's, away from the wall's border."""
    angles = []
    for view, goal in zip(views, normal_images(surface, [view.camera for view in views]), strict=True):
        g = gaussians
        with torch.no_grad():
            sums, _ = rasterize(
                g.position, g.quaternion, g.log_scale, g.opacity, g.sh, g.position.new_zeros(0, g.count), view.camera, 1.5, 0
            )
        rendered = torch.nn.functional.normalize(sums[3:6], dim=0).permute(1, 2, 0).numpy()
        known = binary_erosion((goal**2).sum(-1) > 0, iterations=4)
        angles.append(np.degrees(np.arccos(np.clip((rendered * goal).sum(-1), -1, 1)))[known])
    return float(np.concatenate(angles).mean())


def test_surfels_turn_until_their_image_shows_the_relief(wall):
    surface, views, wrong = wall
    steps = []
    fitted = fit_rendered_normals(wrong, surface, views, 1.5, 120, 0, steps.append)
    assert steps == list(range(1, 121))
    assert error(fitted, surface, views) < 0.6 * error(wrong, surface, views)
    assert fitted.position is wrong.position
    assert torch.allclose(fitted.quaternion.norm(dim=0), torch.ones(fitted.count), atol=1e-5)


def test_same_seed_same_fit(wall):
    surface, views, wrong = wall
    first, second = (fit_rendered_normals(wrong, surface, views, 1.5, 12, 3) for _ in range(2))
    assert first.quaternion.equal(second.quaternion)
