# SPDX-License-Identifier: GPL-3.0-or-later
"""Points sampled on a bare surface, and its state."""

import numpy as np
import pytest
from irgspp.core.scene.surface import Surface, draw_on_triangles

VERTICES = np.array([[0, 0, 0], [2, 0, 0], [0, 2, 0], [0, 0, 5], [1, 0, 5], [0, 1, 5]], float)
NORMALS = np.array([[0, 0, 1], [0.6, 0, 0.8], [0, 0, 1], [0, 0, -1], [0, 0, -1], [0, 0, -1]], float)
FACES = np.array([[0, 1, 2], [3, 5, 4], [0, 0, 1]])  # areas 2, 0.5 and none


@pytest.fixture
def surface():
    return Surface(VERTICES, NORMALS, FACES, 0.1)


def test_samples_spread_by_area(surface):
    position, _ = surface.samples(20_000, np.random.default_rng(0))
    low = position[:, 2] < 2.5
    assert low.mean() == pytest.approx(0.8, abs=0.015)
    for part, size in ((position[low], 2.0), (position[~low], 1.0)):  # uniform: the mean is the centroid, halves hold what they should
        np.testing.assert_allclose(part[:, :2].mean(0), size / 3, atol=0.02 * size)
        assert (part[:, :2].sum(1) < size * 0.5**0.5).mean() == pytest.approx(0.5, abs=0.03)
        assert (part[:, :2] >= 0).all() and (part[:, :2].sum(1) <= size * (1 + 1e-6)).all()


def test_samples_lie_on_the_triangles_with_normals_between_the_corners(surface):
    position, normal = surface.samples(500, np.random.default_rng(1))
    assert position.dtype == normal.dtype == np.float32 and position.shape == normal.shape == (500, 3)
    assert set(np.round(position[:, 2], 6)) == {0.0, 5.0}
    np.testing.assert_allclose(np.linalg.norm(normal, axis=1), 1, atol=1e-6)
    weight = position[:, 0] / 2  # of the corner with the tilted normal
    expected = np.stack([0.6 * weight, 0 * weight, 1 - 0.2 * weight], 1)
    expected = np.where(position[:, 2:] < 1, expected / np.linalg.norm(expected, axis=1, keepdims=True), [0, 0, -1])
    np.testing.assert_allclose(normal, expected, atol=1e-6)


def test_points_are_drawn_on_triangles_by_area():
    pick, weight = draw_on_triangles(np.array([1.0, 0.0, 3.0]), 10_000, np.random.default_rng(0))
    assert (np.bincount(pick, minlength=3) / 10_000).tolist() == pytest.approx([0.25, 0, 0.75], abs=0.02)
    assert weight.shape == (10_000, 3, 1) and (weight >= 0).all()
    np.testing.assert_allclose(weight.sum(1), 1, atol=1e-12)
    np.testing.assert_allclose(weight.mean(0)[:, 0], 1 / 3, atol=0.01)


def test_samples_depend_on_the_generator_alone(surface):
    one, same, other = (surface.samples(50, np.random.default_rng(seed))[0] for seed in (3, 3, 4))
    assert np.array_equal(one, same) and not np.array_equal(one, other)


def test_state_restores_all(surface):
    copy = Surface.restored(surface.state())
    assert copy.voxel == surface.voxel
    for name in ("vertices", "normals", "faces"):
        assert np.array_equal(getattr(copy, name), getattr(surface, name))
