# SPDX-License-Identifier: GPL-3.0-or-later
"""The prior of the light: differences of neighbours on the sphere, counted less across edges."""

import math

import numpy as np
import pytest
import torch
from irgspp.core.stages.second.solver.light_prior import (
    HALF_WEIGHT_SLOPE,
    INDEPENDENT_ERRORS,
    MAX_LIKELY_TINT,
    ROUGH_EDGE,
    ROUGH_ERROR,
    SEEN_WEIGHT,
    SMOOTHNESS,
    LightPrior,
)
from irgspp.core.stages.second.solver.light_texels import LightTexels
from irgspp.core.stages.second.solver.seen_light import SeenLight

HEIGHT, WIDTH = 4, 8
EDGE = HALF_WEIGHT_SLOPE * math.pi / HEIGHT
PAIRS = HEIGHT * WIDTH + (HEIGHT - 1) * WIDTH  # across, around the seam, and down


@pytest.fixture(scope="module")
def prior():
    return LightPrior(LightTexels.uniform(HEIGHT), "cpu")


def test_laplacian_sums_squared_differences_of_neighbours(prior):
    light = np.random.default_rng(0).random((HEIGHT, WIDTH))
    expected = 0.0
    for i in range(HEIGHT):
        for j in range(WIDTH):
            expected += (light[i, j] - light[i, (j + 1) % WIDTH]) ** 2  # around, across the seam
            expected += (light[i, j] - light[i + 1, j]) ** 2 if i + 1 < HEIGHT else 0.0
    form, values = prior.laplacian(torch.ones(PAIRS, dtype=torch.float64)), torch.from_numpy(light.reshape(-1))
    assert float(values @ form @ values) == pytest.approx(expected, rel=1e-9)
    assert torch.equal(form, form.T) and (form.sum(1) == 0).all()


def test_small_differences_count_in_full_and_edges_hardly(prior):
    """The curvature across one edge of the map falls as 1 / (1 + (d / EDGE)^2)."""
    for step in (1e-3, EDGE, 10 * EDGE):
        log_light = torch.zeros(HEIGHT * WIDTH, 3, dtype=torch.float64)
        log_light[0] = step
        curvature = float(prior.form(log_light.exp(), 0.0)[0, 0])
        assert curvature == pytest.approx(3 * SMOOTHNESS / (1 + (step / EDGE) ** 2), rel=1e-9)  # the texel has three neighbours


def test_small_texels_are_smoother_the_noisier_the_photographs_are():
    """Texels of 32 rows have an edge of .25; with noise it rises to ROUGH_EDGE."""
    fine, step = LightPrior(LightTexels.uniform(32), "cpu"), 0.5
    log_light = torch.zeros(2048, 3, dtype=torch.float64)
    log_light[64 * 16] = step  # with four neighbours
    for error, edge in ((0.0, HALF_WEIGHT_SLOPE * math.pi / 32), (0.8 * ROUGH_ERROR, 0.64 * ROUGH_EDGE), (9 * ROUGH_ERROR, ROUGH_EDGE)):
        curvature = float(fine.form(log_light.exp(), error)[64 * 16, 64 * 16])
        assert curvature == pytest.approx(4 * SMOOTHNESS / (1 + (step / edge) ** 2), rel=1e-6)


def test_light_is_pulled_towards_what_the_photographs_show():
    """The gradient is that of SEEN_WEIGHT / 2 times the squared difference of the log light in the one texel that was seen."""
    texels, direction = LightTexels.uniform(HEIGHT), np.tile([[0.2, 0.3, 0.9]], (6, 1)) / math.sqrt(0.94)
    shown = SeenLight(direction, np.tile([[0.4, 0.2, 0.1]], (6, 1)), np.zeros(6, bool), np.zeros(6, int))
    seen = int(texels.containing(direction)[0])
    light = torch.full((texels.count, 3), 1.5)
    form, slope = LightPrior(texels, "cpu", shown).terms(light, 0.0)
    weight = SEEN_WEIGHT * texels.solid_angles[seen] * texels.count / (4 * math.pi)
    assert float(form.sum()) == pytest.approx(weight, rel=1e-3)
    assert slope[seen].tolist() == pytest.approx((weight * np.log([1.5 / 0.4, 1.5 / 0.2, 1.5 / 0.1])).tolist(), rel=1e-3)
    slope[seen] = 0
    assert float(slope.abs().max()) < 1e-3 * weight


def test_constant_light_costs_nothing_and_has_no_slope(prior):
    light = torch.full((HEIGHT * WIDTH, 3), 0.7, dtype=torch.float64)
    log_light = light[:, 0].log()
    assert float((prior.form(light, 0.0) @ log_light).abs().max()) < 1e-12 * SMOOTHNESS / EDGE


def test_tint_is_that_of_the_mean_over_the_sphere(prior):
    rows = torch.tensor([[0.2, 0.4, 0.4], [0.8, 0.5, 0.1]]).repeat_interleave(HEIGHT * WIDTH // 2, 0)  # upper and lower half
    tint = prior.tint(rows)
    assert float(tint.sum()) == pytest.approx(0, abs=1e-6)
    mean = np.log([0.5, 0.45, 0.25])
    assert np.allclose(tint.numpy(), mean - mean.mean(), atol=1e-6)
    brighter = prior.tint(7 * rows)
    assert torch.allclose(brighter, tint, atol=1e-6)


def test_likely_tint_is_the_fitted_one_where_photographs_tell_and_none_where_they_do_not(prior):
    light = torch.tensor([[0.9, 0.5, 0.2]]).expand(HEIGHT * WIDTH, 3)
    tint, error = prior.tint(light), 0.01
    assert torch.allclose(prior.likely_tint(light, torch.full((3,), 1e3), error), tint, atol=1e-5)
    assert prior.likely_tint(light, torch.full((3,), 1e-15), error).abs().max() < 0.01


def test_likely_tint_costs_least(prior):
    """Of all tints it has the least sum of the error's rise and the prior's negative logarithm."""
    light, error, curvature = torch.tensor([[0.75, 0.5, 1 / 3]]).expand(HEIGHT * WIDTH, 3), 0.02, 2e-4
    tint = float(prior.tint(light)[0])
    likely = float(prior.likely_tint(light, torch.full((3,), curvature), error)[0])
    variance = (error / 0.6745) ** 2 / INDEPENDENT_ERRORS
    choices = np.linspace(-1, 1, 20_001)
    cost = curvature * (choices - tint) ** 2 / (2 * variance) + (choices / MAX_LIKELY_TINT) ** 4 / 4
    assert likely == pytest.approx(choices[cost.argmin()], abs=2e-4)
    assert 0.2 * tint < likely < 0.9 * tint
