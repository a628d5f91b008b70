# SPDX-License-Identifier: GPL-3.0-or-later
"""The prior of the roughness decides where a point's own evidence does not."""

import torch
from irgspp.core.stages.second.solver import roughness_prior
from irgspp.core.stages.second.solver.roughness_prior import EM_PASSES, INDEPENDENT_ERRORS, MIN_PRIOR, with_roughness_prior

KNOTS = torch.tensor([0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.8, 1.0])
RED, BLUE = (0.6, 0.1, 0.1), (0.1, 0.1, 0.6)


def costs(roughness, slope=1.0, noise=1.0):
    """Costs of points with these roughnesses: `noise` at the minimum, and rising by `slope` for a difference of 0.1."""
    return noise + slope * ((KNOTS[None] - torch.tensor(roughness)[:, None]) / 0.1).square()


def likely(cost, albedo):
    return KNOTS[with_roughness_prior(cost, torch.tensor(albedo)).argmin(1)]


def test_a_point_without_evidence_takes_the_roughness_of_its_colour():
    cost = torch.cat([costs([0.3] * 20), costs([0.8] * 20), costs([1.0, 1.0], slope=1e-3)])
    found = likely(cost, [RED] * 20 + [BLUE] * 20 + [RED, BLUE])
    torch.testing.assert_close(found[-2:], torch.tensor([0.3, 0.8]))
    torch.testing.assert_close(found[:40], torch.tensor([0.3] * 20 + [0.8] * 20))


def test_a_point_with_clear_evidence_keeps_its_own():
    found = likely(torch.cat([costs([0.3] * 40), costs([0.8], slope=3.0)]), [RED] * 41)
    assert float(found[-1]) == KNOTS[6]


def test_two_finishes_of_one_colour_both_stay():
    found = likely(torch.cat([costs([0.2] * 20), costs([0.6] * 20)]), [RED] * 40)
    torch.testing.assert_close(found, torch.tensor([0.2] * 20 + [0.6] * 20))


def test_many_points_take_the_prior_of_some(monkeypatch):
    cost = torch.cat([costs([0.3] * 20), costs([0.8] * 20), costs([1.0, 1.0], slope=1e-3)])
    colours = [RED] * 20 + [BLUE] * 20 + [RED, BLUE]
    monkeypatch.setattr(roughness_prior, "MAX_SOURCES", 10)
    monkeypatch.setattr(roughness_prior, "BATCH", 7)
    torch.testing.assert_close(likely(cost, colours)[-2:], torch.tensor([0.3, 0.8]))


def test_no_points():
    assert with_roughness_prior(torch.empty(0, 8), torch.empty(0, 3)).shape == (0, 8)


def test_twin():
    generator = torch.Generator().manual_seed(3)
    cost, albedo = 1 + 9 * torch.rand(12, 8, generator=generator), torch.rand(12, 3, generator=generator)
    torch.testing.assert_close(
        with_roughness_prior(cost, albedo).double(), plain_prior(cost.double(), albedo.double()), rtol=1e-4, atol=1e-5
    )


def plain_prior(cost, albedo):
    """The same in float64, a point at a time."""
    scale = torch.tensor([[max(float(one.min()), float(cost.amin(1).median())) / INDEPENDENT_ERRORS] for one in cost], dtype=cost.dtype)
    log_albedo, prior = albedo.clamp_min(0.02).log(), torch.ones_like(cost)
    for done in range(EM_PASSES + 1):
        likelihood = (-cost / scale).exp() * (prior + MIN_PRIOR if done else prior)
        posterior = likelihood / likelihood.sum(1, keepdim=True)
        alike = [1 / (1 + (log_albedo - one).square().sum(1) / 0.15**2) ** 2 for one in log_albedo]
        prior = torch.stack([(weight[:, None] * posterior).sum(0) / weight.sum() for weight in alike])
    return cost - scale * (prior + MIN_PRIOR).log()
