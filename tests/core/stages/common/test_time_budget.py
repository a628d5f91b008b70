# SPDX-License-Identifier: GPL-3.0-or-later
"""Schedules scaled to a time budget."""

from dataclasses import replace

import pytest
from irgspp.core.datasets.load import load_dataset
from irgspp.core.machine.job_time import fixed_seconds, reference_seconds, refinement_step_seconds, schedule_seconds, step_seconds
from irgspp.core.pipeline import DEMO_DATA
from irgspp.core.settings.schema import preset
from irgspp.core.stages.common.time_budget import (
    MAX_FIRST_STAGE_STEPS,
    MAX_SECOND_STAGE_SCALE,
    MIN_SCALE,
    STEP_COST_GROWTH,
    STEP_COST_GROWTH_SINGLE,
    first_stage_schedule_scale,
    joint_schedule_scale,
    scaled_iterations,
    second_stage_schedule_scale,
    seconds_per_step,
)

SETTINGS = preset("balanced")


@pytest.fixture(scope="module")
def data():
    return load_dataset(DEMO_DATA, SETTINGS.data)


@pytest.mark.parametrize("schedule_scale", [0.2, 1.0, 2.9])
@pytest.mark.parametrize(("rays", "growth"), [(1, STEP_COST_GROWTH_SINGLE), (2, STEP_COST_GROWTH)])
def test_what_the_first_stage_is_given_costs_what_there_is(data, schedule_scale, rays, growth):
    """The machine is so fast that the mean step takes half the time of the estimate's."""
    settings = replace(SETTINGS, first=replace(SETTINGS.first, subpixels=rays))
    expected = step_seconds(settings, data)
    schedules = settings.first.iterations * expected + schedule_seconds(settings, data)
    cost = 0.5 * (fixed_seconds(settings, data) + schedule_scale * schedules)
    assert first_stage_schedule_scale(settings, data, cost, 0.5 * expected / growth) == pytest.approx(schedule_scale)


def test_a_capture_without_masks_has_time_for_its_schedule(data):
    """Its steps are long, its other phases are not: they once were taken for as many steps as those of a masked object."""
    unmasked = replace(data, train=[replace(view, alpha=None) for view in data.train])
    settings = replace(SETTINGS, first=replace(SETTINGS.first, subpixels=1))
    usual = reference_seconds(settings, unmasked)
    assert first_stage_schedule_scale(settings, unmasked, usual, step_seconds(settings, unmasked)) == pytest.approx(1, abs=0.25)


@pytest.mark.parametrize("schedule_scale", [0.2, 1.0, 4.0])
@pytest.mark.parametrize("speed", [0.5, 2.0])
def test_what_the_second_stage_is_given_costs_what_there_is(data, schedule_scale, speed):
    cost = speed * schedule_scale * schedule_seconds(SETTINGS, data)
    assert second_stage_schedule_scale(SETTINGS, data, cost, speed * refinement_step_seconds(SETTINGS)) == pytest.approx(schedule_scale)


def test_schedule_scale_has_limits(data):
    paper, draft = preset("paper"), preset("draft")
    assert first_stage_schedule_scale(SETTINGS, data, -5.0, 0.02) == MIN_SCALE
    assert second_stage_schedule_scale(SETTINGS, data, -5.0, 0.02) == MIN_SCALE
    for settings in (SETTINGS, draft):
        scale = first_stage_schedule_scale(settings, data, 1e6, 0.02)
        assert scaled_iterations(scale, settings.first.iterations) == MAX_FIRST_STAGE_STEPS
    assert first_stage_schedule_scale(paper, data, 1e7, 0.02) == 1.0  # never shorter than the preset where there is time
    assert second_stage_schedule_scale(SETTINGS, data, 1e6, 0.02) == MAX_SECOND_STAGE_SCALE
    none = replace(SETTINGS, second=replace(SETTINGS.second, iterations=0, radiance_iterations=0))
    assert second_stage_schedule_scale(none, data, 10.0, 0.02) == 1.0


def test_a_schedule_is_at_least_a_step_unless_it_is_none():
    assert [scaled_iterations(0.5, 300), scaled_iterations(1e-9, 300), scaled_iterations(10.0, 0)] == [150, 1, 0]


def test_a_step_costs_its_median(monkeypatch):
    clock = iter([0.0, 5.0, 5.0, 6.0, 6.0, 7.5])
    monkeypatch.setattr("irgspp.core.stages.common.time_budget.time.monotonic", lambda: next(clock))
    done = []
    assert seconds_per_step(lambda: done.append(1), 3) == 1.5
    assert len(done) == 3


def test_the_joint_optimisation_is_shortened_and_never_lengthened():
    assert joint_schedule_scale(10_000, 500.0, 0.25) == pytest.approx(0.2)
    assert joint_schedule_scale(10_000, 1e6, 0.25) == 1.0
    assert scaled_iterations(joint_schedule_scale(10_000, -5.0, 0.25), 10_000) == 1
