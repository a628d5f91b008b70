# SPDX-License-Identifier: GPL-3.0-or-later
"""Confidence of materials: low where the photographs contradict the reconstruction, and where little light arrives."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from irgspp.core.rendering.secondary_rays import SecondaryTracer
from irgspp.core.scene.dataset import Bound
from irgspp.core.scene.reconstruction import Reconstruction
from irgspp.core.settings.schema import SecondStageSettings
from irgspp.core.stages.second.refinement.material_confidence import expected_errors, nearest_surfels, surfel_errors, with_confidence
from irgspp.core.stages.second.refinement.pixel_pool import pool_pixels, sums_at_surfels
from irgspp.core.stages.second.refinement.refinement import Refinement

SETTINGS = SecondStageSettings(pool=4000)
ALBEDO = 0.5


@pytest.fixture(scope="module")
def sphere(splat_sphere):
    """A sphere of one material under a white sky."""
    material = torch.tensor([ALBEDO, ALBEDO, ALBEDO, 0.5, 0.02])[:, None].expand(5, 3000)
    surfels = replace(splat_sphere(3000, opacity=0.999), material=torch.logit(material).contiguous())
    return Reconstruction(surfels, torch.ones(8, 16, 3), Bound((0.0, 0.0, 0.0), 1.5), np.eye(4))


@pytest.fixture(scope="module")
def tracer(sphere):
    return SecondaryTracer(sphere)


@pytest.fixture(scope="module")
def pool(sphere, tracer, sphere_dataset, camera_ring):
    """Pixels that show exactly what the rendering equation predicts, but for an upper half that is brighter by a fifth."""
    pool = pool_pixels(sphere_dataset(camera_ring(10)).train, tracer, SETTINGS.pool, np.random.default_rng(0))
    trial = Refinement(sphere, pool, tracer, SETTINGS, 0)
    with torch.no_grad():
        shaded = trial._shade(torch.arange(pool.count), (64, 128, 64), sphere.environment, torch.Generator().manual_seed(1))
    brighter = torch.where(pool.point[:, 2:] > 0, 1.2, 1.0)
    encoded = 1.055 * (shaded * brighter) ** (1 / 2.4) - 0.055
    return replace(pool, colour=encoded, saturated=torch.zeros_like(encoded, dtype=torch.bool))


def test_photographs_that_contradict_lower_the_confidence(sphere, pool, tracer):
    known = with_confidence(sphere, pool, tracer, SETTINGS, 0).confidence
    height = sphere.gaussians.position[2]
    assert known.shape == (3, 3000) and ((known >= 0) & (known <= 1)).all()
    for row in known:
        assert row[height > 0.3].median() < 0.5 < 0.7 < row[height < -0.3].median()


def test_noise_of_the_estimates_is_no_error(sphere, pool, tracer):
    error, irradiance = surfel_errors(Refinement(sphere, pool, tracer, SETTINGS, 0), nearest_surfels(sphere), 0)
    height = sphere.gaussians.position[2].numpy()
    shaded = ALBEDO * 0.96
    expected = 1.055 * ((1.2 * shaded) ** (1 / 2.4) - shaded ** (1 / 2.4))
    assert np.median(error[height > 0.3]) == pytest.approx(expected, rel=0.15)
    assert np.median(error[height < -0.3]) < 0.1 * expected
    assert np.median(irradiance) == pytest.approx(1, rel=0.05)  # of a white sky


def test_same_seed_gives_the_same_confidence(sphere, pool, tracer):
    one, other = (with_confidence(sphere, pool, tracer, SETTINGS, 3).confidence for _ in range(2))
    assert torch.equal(one, other)


def test_shade_and_variation_raise_the_expected_error():
    count = 40
    error, irradiance = np.full(count, 0.02), np.ones(count)
    irradiance[:5] = 0.1
    materials = np.full((5, count), 0.5)
    materials[:3, 10:15] += 0.2 * np.random.default_rng(0).random((3, 5))
    materials[3, 20:25] += 0.2 * np.random.default_rng(1).random(5)
    nearest = 5 * (np.arange(count) // 5)[:, None] + np.arange(5)
    albedo, roughness, metallic = expected_errors(error, irradiance, materials, nearest)
    plain = slice(30, 40)
    assert (albedo[:5] > 3 * albedo[plain].max()).all() and (metallic[:5] > 3 * metallic[plain].max()).all()
    assert (albedo[10:15] > 2 * albedo[plain].max()).all() and (roughness[20:25] > 2 * roughness[plain].max()).all()
    assert np.allclose(roughness[10:15], roughness[plain].mean()) and np.allclose(albedo[20:25], albedo[plain].mean())


def test_nothing_is_known_of_what_no_photograph_shows():
    materials, nearest = np.full((5, 4), 0.5), np.arange(4)[:, None].repeat(2, 1)
    expected = expected_errors(np.array([0.01, 0.01, np.inf, 0.02]), np.array([1.0, 1.0, 0.0, 1.0]), materials, nearest)
    assert np.isinf(expected[:, 2]).all() and np.isfinite(expected[:, [0, 1, 3]]).all()
    assert np.isinf(expected_errors(np.full(4, np.inf), np.zeros(4), materials, nearest)).all()


def test_values_of_pixels_are_added_by_weight(pool):
    pixels, values = torch.tensor([3, 7, 20]), torch.tensor([[1.0, 2.0], [3.0, 5.0], [7.0, 11.0]])
    total = sums_at_surfels(pool, pixels, values, 3000)
    expected = np.zeros((3000, 2))
    for pixel, value in zip(pixels, values, strict=True):
        for hit in range(pool.lists.start[pixel], pool.lists.start[pixel + 1]):
            expected[pool.lists.index[hit]] += pool.lists.weight[hit] * value.numpy()
    np.testing.assert_allclose(total, expected, rtol=1e-6)
    assert total.sum() > 0
