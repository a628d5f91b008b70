# SPDX-License-Identifier: GPL-3.0-or-later
"""Relief evidence: shading of a relief whose coarse part the mesh has is relief, grey paint is not."""

import numpy as np
import pytest
from irgspp.core.scene.surface import Surface
from irgspp.core.stages.second.normals.relief_evidence import relief_fraction
from irgspp.core.stages.second.normals.surface_gradient import SurfaceGradient

SIDE = 80
EVERYWHERE = np.ones(SIDE * SIDE, bool)


@pytest.fixture(scope="module")
def plane() -> SurfaceGradient:
    corner = (np.arange(SIDE - 1)[:, None] * SIDE + np.arange(SIDE - 1)).ravel()
    faces = np.concatenate([np.stack([corner, corner + 1, corner + SIDE], 1), np.stack([corner + 1, corner + SIDE + 1, corner + SIDE], 1)])
    vertices = np.stack([*np.divmod(np.arange(SIDE * SIDE), SIDE), np.zeros(SIDE * SIDE)], 1).astype(float)
    return SurfaceGradient.of(Surface(vertices, np.tile([0.0, 0.0, 1.0], (SIDE * SIDE, 1)), faces, 1.0))


def texture(seed: int, operators: SurfaceGradient, passes: int) -> np.ndarray:
    """Return noise (V,) with standard deviation 1, smoothed."""
    values = np.random.default_rng(seed).standard_normal(SIDE * SIDE)
    for _ in range(passes):
        values = 0.5 * (values + operators.average @ values)
    return (values - values.mean()) / values.std()


def test_shading_of_a_relief_whose_coarse_part_the_mesh_has_is_relief(plane: SurfaceGradient):
    coarse, fine = texture(0, plane, 12), texture(1, plane, 0)
    found = relief_fraction(0.3 * coarse + 0.1 * fine - 1.0, 0.2 * coarse + 0.5, EVERYWHERE, plane)
    assert np.median(found) == 1
    assert found.mean() > 0.95


def test_grey_paint_on_a_mesh_with_noise_of_its_own_is_not(plane: SurfaceGradient):
    found = relief_fraction(0.3 * texture(0, plane, 12), 0.05 * texture(1, plane, 12), EVERYWHERE, plane)
    assert np.median(found) < 0.2
    opposite = relief_fraction(0.3 * texture(0, plane, 12), -0.2 * texture(0, plane, 12), EVERYWHERE, plane)
    assert opposite.max() == 0  # bright where the relief would be dark


def test_a_half_that_is_carved_and_a_half_that_is_painted_are_told_apart(plane: SurfaceGradient):
    relief, paint, noise = (texture(seed, plane, 12) for seed in range(3))
    left = np.arange(SIDE * SIDE) // SIDE < SIDE // 2
    found = relief_fraction(0.2 * np.where(left, relief, paint), 0.1 * np.where(left, relief, 0.2 * noise), EVERYWHERE, plane)
    column = np.arange(SIDE * SIDE) // SIDE
    assert found[column < SIDE // 2 - 15].mean() > 0.9
    assert found[column >= SIDE // 2 + 15].mean() < 0.3


def test_unseen_vertices_do_not_count(plane: SurfaceGradient):
    coarse, seen = texture(0, plane, 12), np.arange(SIDE * SIDE) // SIDE >= 5
    full = relief_fraction(0.3 * coarse, 0.2 * coarse, seen, plane)
    spoiled = relief_fraction(np.where(seen, 0.3 * coarse, np.nan), 0.2 * coarse, seen, plane)
    assert np.array_equal(full, spoiled)
    nowhere = relief_fraction(0.3 * coarse, 0.2 * coarse, ~EVERYWHERE, plane)
    assert not nowhere.any()
