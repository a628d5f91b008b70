# SPDX-License-Identifier: GPL-3.0-or-later
"""Schedules made to fit a time."""

from dataclasses import replace

import pytest
from irgspp.core.settings.schema import preset
from irgspp.core.stages.common.time_budget import (
    FIRST_LONGEST,
    GROWTH,
    RADIANCE,
    RADIANCE_GLOSSY,
    REST,
    REST_GLOSSY,
    SECOND,
    SECOND_LONGEST,
    SHORTEST,
    first_schedule_scale,
    second_schedule_scale,
    seconds_a_step,
    times,
)

SETTINGS = preset("balanced")


@pytest.mark.parametrize("pace", [0.2, 1.0, 2.9])
@pytest.mark.parametrize(("glossy", "rest"), [(False, REST), (True, REST_GLOSSY)])
def test_what_the_first_stage_is_given_costs_what_there_is(pace, glossy, rest):
    step = 0.02
    cost = step * (rest + pace * (SECOND + GROWTH * SETTINGS.first.iterations))
    assert first_schedule_scale(SETTINGS.first.iterations, cost, glossy, step) == pytest.approx(pace)


@pytest.mark.parametrize("pace", [0.2, 1.0, 4.0])
@pytest.mark.parametrize(("glossy", "radiance"), [(False, RADIANCE), (True, RADIANCE_GLOSSY)])
def test_what_the_second_stage_is_given_costs_what_there_is(pace, glossy, radiance):
    transport = SETTINGS.second
    cost = pace * 0.03 * (transport.iterations + radiance * transport.radiance_iterations)
    assert second_schedule_scale(transport, cost, glossy, 0.03) == pytest.approx(pace)


def test_pace_has_limits():
    transport = SETTINGS.second
    assert first_schedule_scale(1500, -5.0, False, 0.02) == second_schedule_scale(transport, -5.0, False, 0.02) == SHORTEST
    assert (
        times(first_schedule_scale(1500, 1e6, False, 0.02), 1500)
        == times(first_schedule_scale(400, 1e6, False, 0.02), 400)
        == FIRST_LONGEST
    )
    assert first_schedule_scale(50_000, 1e6, False, 0.02) == 1.0  # never shorter than the preset where there is time
    assert second_schedule_scale(transport, 1e6, False, 0.02) == SECOND_LONGEST
    assert second_schedule_scale(replace(transport, iterations=0, radiance_iterations=0), 10.0, False, 0.02) == 1.0


def test_a_schedule_is_at_least_a_step_unless_it_is_none():
    assert [times(0.5, 300), times(1e-9, 300), times(10.0, 0)] == [150, 1, 0]


def test_a_step_costs_its_median(monkeypatch):
    clock = iter([0.0, 5.0, 5.0, 6.0, 6.0, 7.5])
    monkeypatch.setattr("irgspp.core.stages.common.time_budget.time.monotonic", lambda: next(clock))
    done = []
    assert seconds_a_step(lambda: done.append(1), 3) == 1.5
    assert len(done) == 3
