# SPDX-License-Identifier: GPL-3.0-or-later
"""Radiance transfer whose texels are split: the same light reaches the points, and only the new rays are traced."""

import numpy as np
import pytest
import torch
from irgspp.core.rendering.secondary_rays import SecondaryTracer
from irgspp.core.scene.dataset import Bound
from irgspp.core.scene.reconstruction import Reconstruction
from irgspp.core.stages.second.solver.light_texels import LightTexels
from irgspp.core.stages.second.solver.multi_view_samples import MultiViewSamples
from irgspp.core.stages.second.solver.transfer_tracing import SPLIT_TEXELS, split_brightest, trace_radiance_transfer

HEIGHT = 8


@pytest.fixture(scope="module")
def tracer(splat_sphere):
    """Tracer of a unit sphere that emits light."""
    sphere = splat_sphere(3000, np.full((3000, 3), 0.4), 0.999)
    return SecondaryTracer(Reconstruction(sphere, torch.ones(8, 16, 3), Bound((0, 0, 0), 1.0), np.eye(4)))


@pytest.fixture(scope="module")
def samples():
    """Points beside the sphere; no views are needed."""
    random = torch.Generator().manual_seed(0)
    position = 1.4 * torch.nn.functional.normalize(torch.randn(30, 3, generator=random), dim=1)
    normal = torch.nn.functional.normalize(torch.randn(30, 3, generator=random), dim=1)
    none = torch.zeros(0, 3)
    return MultiViewSamples(position, normal, torch.zeros(0, dtype=torch.long), none, none, none.bool())


def test_split_texels_bring_the_same_light_and_others_keep_their_rays(tracer, samples):
    light = torch.rand(2 * HEIGHT**2, 3, generator=torch.Generator().manual_seed(1))
    before = trace_radiance_transfer(samples.position, samples.normal, tracer, LightTexels.uniform(HEIGHT), side=4, seed=0, indirect=True)
    after, old = split_brightest(before, light, samples, tracer, 0, 4 * HEIGHT)
    kept = np.bincount(old, minlength=before.texels.count) == 1
    assert (~kept).sum() == SPLIT_TEXELS and after.texels.count == before.texels.count + 3 * SPLIT_TEXELS
    first, second = (torch.as_tensor(one.traced.visibility).unflatten(1, (16, -1)) for one in (before, after))
    assert torch.equal(first[..., kept], second[..., : kept.sum()])
    assert torch.equal(before.irradiance[:, kept], after.irradiance[:, : kept.sum()])
    np.testing.assert_allclose(after.irradiance @ light[old], before.irradiance @ light, rtol=0.03, atol=0.01)
    np.testing.assert_allclose(after.indirect, before.indirect, rtol=0.1, atol=0.01)


def test_small_texels_stay_as_they_are(tracer, samples):
    before = trace_radiance_transfer(samples.position, samples.normal, tracer, LightTexels.uniform(HEIGHT), side=2, seed=0, indirect=True)
    after, old = split_brightest(before, torch.rand(2 * HEIGHT**2, 3), samples, tracer, 0, HEIGHT)
    assert after is before and np.array_equal(old, np.arange(2 * HEIGHT**2))
