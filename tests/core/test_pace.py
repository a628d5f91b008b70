# SPDX-License-Identifier: GPL-3.0-or-later
"""Schedules made to fit a time."""

import pytest
from irgspp.core.config import preset
from irgspp.core.pace import FASTEST, GROWTH, PACED, REST, SLOWEST, affordable, paced

SETTINGS = preset("balanced")


@pytest.mark.parametrize("pace", [0.2, 1.0, 4.0])
def test_what_is_afforded_costs_what_there_is(pace):
    step = 0.02
    cost = step * (REST + pace * (PACED + GROWTH * SETTINGS.reflective.iterations))
    assert affordable(SETTINGS, cost, step) == pytest.approx(pace)


def test_pace_has_limits():
    assert affordable(SETTINGS, -5.0, 0.02) == FASTEST
    assert affordable(SETTINGS, 1e6, 0.02) == SLOWEST


def test_all_schedules_scale_and_nothing_else_changes():
    half = paced(SETTINGS, 0.5)
    assert half.reflective.iterations == SETTINGS.reflective.iterations // 2
    assert half.transport.iterations == SETTINGS.transport.iterations // 2
    assert half.transport.radiance_iterations == SETTINGS.transport.radiance_iterations // 2
    assert paced(SETTINGS, 1.0) == SETTINGS
    assert paced(SETTINGS, 1e-9).reflective.iterations == 1
