# SPDX-License-Identifier: GPL-3.0-or-later
"""Roughness pooling: doubtful places take the roughness of well-known ones of their kind."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from irgspp.core.scene.dataset import Bound
from irgspp.core.scene.gaussians import METALLIC, ROUGHNESS
from irgspp.core.scene.reconstruction import Reconstruction
from irgspp.core.stages.second.refinement.roughness_pooling import with_pooled_roughness

COUNT = 2000


@pytest.fixture
def sphere(splat_sphere):
    """Function that makes a sphere of given materials (5, N) and confidence (N,) of the roughness."""

    def make(materials, confidence):
        surfels = replace(splat_sphere(COUNT), material=torch.logit(torch.as_tensor(materials, dtype=torch.float32)))
        known = None if confidence is None else torch.as_tensor(confidence, dtype=torch.float32).repeat(3, 1)
        return Reconstruction(surfels, torch.ones(8, 16, 3), Bound((0.0, 0.0, 0.0), 1.5), np.eye(4), confidence=known)

    return make


def plain():
    return np.array([0.5, 0.5, 0.5, 0.4, 0.02])[:, None].repeat(COUNT, 1)


def test_doubtful_surfels_take_the_roughness_of_sure_ones(sphere):
    materials, doubtful = plain(), np.arange(COUNT) % 10 == 0
    materials[3, doubtful] = 0.9
    pooled = with_pooled_roughness(sphere(materials, np.where(doubtful, 0.2, 0.8)), 0).gaussians.materials()
    assert np.allclose(pooled[ROUGHNESS], 0.4, atol=0.01)
    others = [0, 1, 2, METALLIC]
    assert np.allclose(pooled[others], materials[others], atol=1e-6)


def test_sure_surfels_keep_most_of_their_own(sphere):
    materials = plain()
    materials[3] = np.random.default_rng(0).uniform(0.2, 0.6, COUNT)
    pooled = with_pooled_roughness(sphere(materials, np.full(COUNT, 0.7)), 0).gaussians.materials()[ROUGHNESS].numpy()
    assert np.corrcoef(pooled, materials[3])[0, 1] > 0.99
    assert 0.8 * materials[3].std() < pooled.std() < materials[3].std()


def test_metal_is_no_source_for_the_rest(sphere):
    materials, doubtful = plain(), np.arange(COUNT) % 10 == 0
    materials[METALLIC, ~doubtful] = 0.98
    materials[3, doubtful] = 0.9
    pooled = with_pooled_roughness(sphere(materials, np.where(doubtful, 0.3, 0.8)), 0).gaussians.materials()[ROUGHNESS]
    assert np.allclose(pooled[doubtful], 0.9, atol=1e-3)


def test_places_of_like_albedo_count_more(sphere):
    materials, number = plain(), np.arange(COUNT)
    other, doubtful = number % 2 == 0, number % 10 == 1
    materials[:3, other], materials[3, other] = 0.05, 0.8
    materials[3, doubtful] = 0.9
    pooled = with_pooled_roughness(sphere(materials, np.where(doubtful, 0.2, 0.8)), 0).gaussians.materials()[ROUGHNESS]
    assert np.allclose(pooled[doubtful], 0.4, atol=0.03)
    assert np.allclose(pooled[other], 0.8, atol=0.03)


def test_without_confidence_nothing_changes(sphere):
    given = sphere(plain(), None)
    assert with_pooled_roughness(given, 0) is given


def test_same_seed_gives_the_same_roughness(sphere):
    materials = plain()
    materials[3] = np.random.default_rng(0).uniform(0.2, 0.6, COUNT)
    given = sphere(materials, np.random.default_rng(1).uniform(0, 1, COUNT))
    one, other = (with_pooled_roughness(given, 5).gaussians.material for _ in range(2))
    assert torch.equal(one, other) and torch.isfinite(one).all()
