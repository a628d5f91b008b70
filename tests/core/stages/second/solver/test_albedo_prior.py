# SPDX-License-Identifier: GPL-3.0-or-later
"""Prior of the albedo: one constant at first, then the mean of like colours, across brightness more than tints; bad fits follow it."""

import pytest
import torch
from irgspp.core.stages.second.solver.albedo_prior import (
    ALBEDO_RANGE,
    CONSTANT_STEPS,
    RELEASE_WEIGHTS,
    SETTLING_WEIGHT,
    albedo_prior,
    colour_likeness,
    likely_albedo,
)

RED, BLUE = torch.tensor([0.5, 0.2, 0.1]), torch.tensor([0.1, 0.2, 0.5])


def targets(*albedos):
    """Target and weight (len(albedos), 3) for as many groups of 50 points, one of each group."""
    points = torch.stack(albedos).repeat_interleave(50, 0)
    target, weight = albedo_prior(points, CONSTANT_STEPS, 0.5, torch.Generator().manual_seed(0))
    return target[::50], weight[::50]


def test_albedo_is_constant_at_first():
    target, weight = albedo_prior(torch.stack([RED, BLUE]), CONSTANT_STEPS - 1, 0.3, torch.Generator())
    assert (target == 0.3).all() and (weight > 100).all()


def test_tints_are_kept_apart():
    target, _ = targets(RED, BLUE)
    torch.testing.assert_close(target, torch.stack([RED, BLUE]), rtol=0.02, atol=0)


def test_dark_and_bright_paint_of_one_tint_are_pulled_together():
    target, _ = targets(RED, 0.8 * RED, BLUE)
    assert (target[0] < 0.96 * RED).all() and (target[1] > 1.04 * 0.8 * RED).all()
    torch.testing.assert_close(target[0] / target[0].sum(), RED / RED.sum(), rtol=0.05, atol=0)


def test_very_different_brightness_of_one_tint_is_kept():
    target, _ = targets(RED, 0.1 * RED)
    assert (target[1] < 0.13 * RED).all()


def test_weight_falls_by_steps_unless_it_is_given():
    points = torch.stack([RED, BLUE])
    cases = ((CONSTANT_STEPS, None), (40, None), (40, SETTLING_WEIGHT))
    weights = [albedo_prior(points, done, 0.5, torch.Generator().manual_seed(0), given)[1] for done, given in cases]
    first, last, settling = (float(weight.mean()) for weight in weights)
    assert first > settling > last
    assert settling / last == pytest.approx(SETTLING_WEIGHT / RELEASE_WEIGHTS[1], rel=1e-3)


def test_likeness_is_symmetric_and_one_for_equals():
    colours = torch.stack([RED, BLUE]).log()
    likeness = colour_likeness(colours, colours)
    assert torch.equal(likeness, likeness.T) and (likeness.diagonal() == 1).all()
    assert likeness[0, 1] < 0.01


def test_albedos_that_fit_badly_are_pulled_to_like_ones():
    random = torch.Generator().manual_seed(1)
    truth = torch.stack([RED, BLUE]).repeat(200, 1)
    error = torch.where(torch.rand(400, generator=random) < 0.5, 0.3, 3.0)
    fit = truth * (0.05 * error[:, None] * torch.randn(400, 1, generator=random)).exp()  # wrong shading has no tint
    likely = likely_albedo(fit, torch.full_like(fit, 2.0), error, truth, 0)
    before, after = ((values / truth).log().abs().mean(1) for values in (fit, likely))
    bad = error > 1
    assert after[bad].mean() < 0.8 * before[bad].mean() and after[~bad].mean() < before[~bad].mean()
    followed = ((likely - fit).abs() / (truth - fit).abs().clamp_min(1e-4)).mean(1)
    assert followed[~bad].median() < 0.6 * followed[bad].median()


def test_a_colour_of_its_own_stays_and_without_evidence_others_decide():
    fit = torch.stack([RED, 0.9 * BLUE])
    likely = likely_albedo(fit, torch.tensor([[1.0] * 3, [0.0] * 3]), torch.ones(2), BLUE.expand(50, 3), 0)
    torch.testing.assert_close(likely[0], RED, rtol=0.02, atol=0)
    torch.testing.assert_close(likely[1], BLUE, rtol=0.02, atol=0)


def test_a_fit_outside_the_range_stays_within_it():
    fit = torch.tensor([[-0.5, 0.3, 0.6], [9.0, 0.3, 0.6]])
    likely = likely_albedo(fit, torch.ones(2, 3), torch.ones(2), RED.expand(50, 3), 0)
    assert likely.isfinite().all() and likely.min() >= ALBEDO_RANGE[0] and likely.max() <= ALBEDO_RANGE[1]
