# SPDX-License-Identifier: GPL-3.0-or-later
"""Albedo pooling of metal: pictures of the surroundings fade from it, tints and all other materials stay."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from irgspp.core.scene.dataset import Bound
from irgspp.core.scene.gaussians import ALBEDO, METALLIC
from irgspp.core.scene.reconstruction import Reconstruction
from irgspp.core.stages.second.metal import TINT_WIDTH
from irgspp.core.stages.second.refinement.metal_albedo import LOGIT_MARGIN, POOLED_SHARE, tint_weighted_medians, with_pooled_metal_albedo

COUNT = 1500
GOLD, STEEL = np.array([0.9, 0.65, 0.3]), np.array([0.6, 0.6, 0.62])


@pytest.fixture
def sphere(splat_sphere):
    """Function that makes a sphere of given albedo (3, N) and metallic (N,)."""

    def make(albedo, metallic):
        materials = np.concatenate([albedo, np.full((1, COUNT), 0.3), metallic[None]])
        surfels = replace(splat_sphere(COUNT), material=torch.logit(torch.as_tensor(materials, dtype=torch.float32)))
        return Reconstruction(surfels, torch.ones(8, 16, 3), Bound((0.0, 0.0, 0.0), 1.5), np.eye(4))

    return make


def test_a_picture_of_the_surroundings_fades_from_metal_alone(sphere):
    random = np.random.default_rng(0)
    brightness = random.uniform(-0.3, 0.3, COUNT)
    brightness -= np.median(brightness)
    albedo, metallic = GOLD[:, None] * np.exp(brightness) * 0.75, np.where(np.arange(COUNT) % 3 == 0, 0.02, 0.98)
    given = sphere(albedo, metallic)
    before, pooled = (one.gaussians.materials().numpy() for one in (given, with_pooled_metal_albedo(given, 0)))
    metal = metallic > 0.5
    assert np.array_equal(pooled[:, ~metal], before[:, ~metal])
    assert np.array_equal(pooled[3:], before[3:])
    left = np.log(pooled[ALBEDO][:, metal] / (0.75 * GOLD[:, None]))
    assert np.allclose(left, (1 - POOLED_SHARE) * brightness[metal], atol=0.03)


def test_metals_of_two_tints_keep_them(sphere):
    gold = np.arange(COUNT) % 2 == 0
    albedo = np.where(gold, GOLD[:, None], STEEL[:, None])
    pooled = with_pooled_metal_albedo(sphere(albedo, np.full(COUNT, 0.98)), 0).gaussians.materials()[ALBEDO].numpy()
    assert np.allclose(pooled, albedo, rtol=0.01)


def test_without_metal_nothing_changes(sphere):
    given = sphere(np.full((3, COUNT), 0.5), np.full(COUNT, 0.1))
    assert with_pooled_metal_albedo(given, 0) is given


def test_black_and_white_metal_stays_finite(sphere):
    albedo = np.where(np.arange(COUNT) % 2 == 0, LOGIT_MARGIN, 1 - LOGIT_MARGIN)[None].repeat(3, 0)
    pooled = with_pooled_metal_albedo(sphere(albedo, np.full(COUNT, 0.98)), 0).gaussians.material
    assert pooled.isfinite().all() and (pooled[METALLIC] > 0).all()


def test_medians_weigh_sources_by_their_tint():
    random = np.random.default_rng(1)
    log, sources = random.normal(-1, 0.2, (50, 3)), random.normal(-1, 0.2, (81, 3))
    tint = lambda x: np.stack([x[:, 0] - x[:, 1], x[:, 2] - x[:, 1]], 1)  # noqa: E731
    for point, found in zip(log, tint_weighted_medians(log, sources), strict=True):
        weight = np.exp(-0.5 * np.square(tint(sources) - tint(point[None])).sum(1) / TINT_WIDTH**2)
        for channel in range(3):  # half of the weight lies on either side of a weighted median
            values = sources[:, channel]
            assert weight[values < found[channel]].sum() <= 0.5001 * weight.sum()
            assert weight[values > found[channel]].sum() <= 0.5001 * weight.sum()
