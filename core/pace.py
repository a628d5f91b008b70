# SPDX-License-Identifier: GPL-3.0-or-later
"""How long schedules may be for a job to end within the time it is given."""

from __future__ import annotations

from dataclasses import replace

from .config import Settings

MEASURED = 40  # steps of the first stage after which the cost of one is known
GROWTH = 1.2  # what a step costs on average, by then: colour comes to depend on the view
REST, PACED = 1000, 350  # what other phases cost, in steps of the first stage: whatever the pace, and at the preset's own
SLOWEST, FASTEST = 10.0, 0.1  # times the preset's own schedules


def affordable(settings: Settings, seconds: float, step: float) -> float:
    """Times the preset's schedules that so many seconds pay for, where a step of the first stage takes `step` seconds."""
    preset = GROWTH * settings.reflective.iterations + PACED
    return min(max((seconds / step - REST) / preset, FASTEST), SLOWEST)


def paced(settings: Settings, pace: float) -> Settings:
    """Settings with all schedules times `pace`."""
    reflective, transport = settings.reflective, settings.transport
    return replace(
        settings,
        reflective=replace(reflective, iterations=max(1, round(pace * reflective.iterations))),
        transport=replace(
            transport,
            iterations=round(pace * transport.iterations),
            radiance_iterations=round(pace * transport.radiance_iterations),
        ),
    )
