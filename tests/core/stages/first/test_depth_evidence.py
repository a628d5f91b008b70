# SPDX-License-Identifier: GPL-3.0-or-later
"""Evidence for one of two surfaces: a textured wall, at its own depth and at wrong ones."""

from pathlib import Path

import numpy as np
import pytest
from irgspp.core.scene.camera import Camera, look_at
from irgspp.core.scene.dataset import Bound, View
from irgspp.core.stages.first.depth_evidence import DepthEvidence

SOURCES = [[1, 2], [0, 3], [0, 3], [1, 2]]


@pytest.fixture(scope="module")
def wall():
    """Masked views of the textured wall z = 0, and its depth in each."""
    views, depths = [], []
    for x, y in ((-0.4, -0.4), (-0.4, 0.4), (0.4, -0.4), (0.4, 0.4)):
        camera = Camera(64, 64, 90, 90, 32, 32, look_at(np.array([x, y, 3.0]), np.zeros(3), up=(0, 1, 0)))
        rays = camera.rays().astype(np.float64)
        depth = -camera.centre[2] / rays[..., 2]
        points = camera.centre + depth[..., None] * rays
        grey = 0.5 + 0.2 * np.sin(17 * points[..., 0]) + 0.2 * np.sin(23 * points[..., 1] + 9 * points[..., 0])
        colour = np.repeat(grey[..., None], 3, -1).astype(np.float32)
        views.append(View(f"{x}{y}", camera, Path("wall.png"), colour, np.ones((64, 64), np.float32)))
        depths.append(depth.astype(np.float32))
    return views, depths


def test_the_right_depth_wins_in_its_region_only(wall):
    views, depths = wall
    wrong = [np.where(view.camera.centre[0] + depth * view.camera.rays()[..., 0] > 0, 1.06 * depth, depth).astype(np.float32)
             for view, depth in zip(views, depths, strict=True)]  # fmt: skip
    evidence = DepthEvidence.collect(views, Bound((0.0, 0.0, 0.0), 1.0), (wrong, depths), SOURCES, 0.01)
    right, left, nowhere = np.array([[0.3, 0, 0]]), np.array([[-0.3, 0, 0]]), np.array([[0, 0, 0.8]])
    assert evidence.ratio(right)[0] < 0.5
    assert evidence.ratio(left)[0] == pytest.approx(1, abs=0.02)
    assert evidence.ratio(nowhere)[0] == 1


def test_equal_depths_are_equally_good(wall):
    views, depths = wall
    evidence = DepthEvidence.collect(views, Bound((0.0, 0.0, 0.0), 1.0), (depths, depths), SOURCES, 0.01)
    points = np.random.default_rng(0).uniform(-0.5, 0.5, (50, 3)) * [1, 1, 0]
    assert np.allclose(evidence.ratio(points), 1)
