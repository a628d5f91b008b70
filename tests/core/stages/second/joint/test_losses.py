# SPDX-License-Identifier: GPL-3.0-or-later
"""Losses of the joint optimisation against their definitions."""

from pathlib import Path

import numpy as np
import pytest
import torch
from irgspp.core.scene.dataset import View
from irgspp.core.shading.environment_lookup import lookup
from irgspp.core.shading.sampling import LightDistribution, draw
from irgspp.core.stages.common.training_view import make_training_view
from irgspp.core.stages.second.joint.losses import edge_aware_smoothness, mask_entropy, seen_light_variation, sobel, white_balance
from irgspp.core.stages.second.joint.model import PixelPlan
from joint_scene import SIZE, camera, disc, random_image


def test_sobel_measures_the_slope_of_a_ramp():
    row = torch.arange(7.0)
    ramp = (3 * row[:, None] + 2 * row)[None]
    across, down = sobel(ramp)[0, :, 1:-1, 1:-1]
    assert torch.allclose(across, torch.tensor(2.0)) and torch.allclose(down, torch.tensor(3.0))


def test_smoothness_costs_less_where_the_photograph_has_an_edge():
    step = torch.zeros(1, 8, 8)
    step[:, :, 4:] = 1
    plain, inside = torch.zeros(3, 8, 8), torch.ones(8, 8)
    cost = edge_aware_smoothness(step, inside, plain)
    assert float(cost) == pytest.approx(2 * 0.5 / 8)  # two of eight columns with a slope of a half
    edge = edge_aware_smoothness(step, inside, step.expand(3, 8, 8))
    assert float(edge) == pytest.approx(float(cost) * np.exp(-0.5))
    assert float(edge_aware_smoothness(torch.full((3, 8, 8), 0.5), inside, plain)) == 0
    assert float(edge_aware_smoothness(step, torch.zeros(8, 8), plain)) == 0


def test_mask_entropy_is_least_where_opacity_is_the_mask():
    mask = disc()
    view = make_training_view(View("0", camera(), Path("0.png"), random_image().permute(1, 2, 0).numpy(), mask))
    alpha = torch.from_numpy(mask)
    least = mask_entropy(alpha, view)
    for other in (alpha * 0.9, 1 - alpha, torch.full_like(alpha, 0.5)):
        assert mask_entropy(other, view) > least
    assert mask_entropy(torch.full_like(alpha, 0.5), view) == pytest.approx(np.log(2), rel=1e-5)


@pytest.mark.parametrize("counts", [(2000, 0, 0), (500, 500, 1000), (0, 1000, 1000)])
def test_white_balance_does_not_depend_on_the_sampling(counts):
    """The mean is over solid angle: a red lamp counts by its size, however many samples it draws."""
    light = torch.full((16, 32, 3), 0.2)
    light[2:4, 4:8, 0] = 20.0
    normal = torch.nn.functional.normalize(torch.tensor([[0.2, 0.1, 1.0]]), dim=1)
    samples = draw(normal, normal, torch.tensor([0.6]), counts, LightDistribution(light), torch.Generator().manual_seed(0))
    above = torch.nonzero((samples.direction @ normal[0] > 0).flatten())[:, 0]
    incoming = lookup(light, samples.direction[0])[None]
    grid = torch.nn.functional.normalize(torch.randn(400_000, 3, generator=torch.Generator().manual_seed(1)), dim=1)
    mean = lookup(light, grid[grid @ normal[0] > 0]).mean(0)
    expected = (mean - mean.mean()).abs().mean()
    ours = white_balance(incoming, PixelPlan(torch.zeros(1, dtype=torch.long), samples, above))
    assert float(ours) == pytest.approx(float(expected), rel=0.12)
    grey = white_balance(incoming.mean(-1, keepdim=True).expand_as(incoming), PixelPlan(above[:1], samples, above))
    assert float(grey) == pytest.approx(0, abs=1e-6)


def test_the_variation_of_the_light_is_that_of_the_view():
    rays = torch.from_numpy(camera().rays()).permute(2, 0, 1)
    assert float(seen_light_variation(torch.full((8, 16, 3), 0.5), rays)) == pytest.approx(0, abs=1e-10)
    behind, before = torch.full((8, 16, 3), 0.5), torch.full((8, 16, 3), 0.5)
    before[7:, ::2] = 3.0  # the camera looks down
    behind[:1, ::2] = 3.0
    assert float(seen_light_variation(behind, rays)) < 1e-8 < float(seen_light_variation(before, rays))
    assert rays.shape[1:] == (SIZE, SIZE)
