# SPDX-License-Identifier: GPL-3.0-or-later
"""Masked views of a textured wall, the plane z = 0, and its depth in each."""

from pathlib import Path

import numpy as np
from irgspp.core.scene.camera import Camera, look_at
from irgspp.core.scene.dataset import Bound, Dataset, View

SOURCES = [[1, 2], [0, 3], [0, 3], [1, 2]]  # views that each view is compared with
BOUND = Bound((0.0, 0.0, 0.0), 1.0)


def textured_wall(shine: float = 0.0) -> tuple[Dataset, list[np.ndarray]]:
    """Return four views and the depth (64, 64) of each.

    Args:
        shine: strength of a pattern on the right half that differs from view to view, as reflections do.
    """
    views, depths = [], []
    for x, y in ((-0.4, -0.4), (-0.4, 0.4), (0.4, -0.4), (0.4, 0.4)):
        camera = Camera(64, 64, 90, 90, 32, 32, look_at(np.array([x, y, 3.0]), np.zeros(3), up=(0, 1, 0)))
        rays = camera.rays().astype(np.float64)
        depth = -camera.centre[2] / rays[..., 2]
        points = camera.centre + depth[..., None] * rays
        grey = 0.5 + 0.2 * np.sin(17 * points[..., 0]) + 0.2 * np.sin(23 * points[..., 1] + 9 * points[..., 0])
        grey += shine * np.where(points[..., 0] > 0, np.sin(15 * points[..., 1] + 40 * x + 90 * y), 0)
        colour = np.repeat(grey[..., None], 3, -1).astype(np.float32)
        views.append(View(f"{x}{y}", camera, Path("wall.png"), colour, np.ones((64, 64), np.float32)))
        depths.append(depth.astype(np.float32))
    return Dataset(Path("wall"), "transforms", views, [], BOUND, np.eye(4)), depths


def bent(dataset: Dataset, depths: list[np.ndarray], factor: float) -> list[np.ndarray]:
    """Return the depths with those of the right half, x > 0, multiplied by a factor."""
    right = [view.camera.centre[0] + depth * view.camera.rays()[..., 0] > 0 for view, depth in zip(dataset.train, depths, strict=True)]
    return [np.where(side, factor * depth, depth).astype(np.float32) for side, depth in zip(right, depths, strict=True)]
