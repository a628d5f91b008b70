# SPDX-License-Identifier: GPL-3.0-or-later
"""How long schedules may be for a job to end within the time it is given.

The first stage gets what is left once the phases that nobody can shorten are paid for, by estimate; the second, which begins when most
of the job is done, what is then left, so that it makes up for what the estimate missed.
"""

from __future__ import annotations

import statistics
import time
from collections.abc import Callable

from ...settings.schema import SecondStageSettings

MEASURED = 20  # steps after which the cost of one is known
GROWTH = 1.2  # what a step of the first stage costs on average, by then: colour comes to depend on the view
REST, REST_GLOSSY = 1000, 750  # what the phases of fixed length cost, in steps of the first stage; one that reflects costs more
SECOND = 400  # the same of the second stage's schedules at the preset's own length
FUSED = 2.5  # what follows the second stage takes so many times as long as fusing the surface did
RADIANCE, RADIANCE_GLOSSY = 1.2, 2.3  # a step that fits the radiance, in steps of the refinement
SHORTEST = 0.1  # times the preset's own schedules
# Longer ones were seen to fit the photographs' noise: normals, albedo and relit images get worse again.
FIRST_LONGEST = 4500  # steps, unless the preset has more
SECOND_LONGEST = 5.0  # times the preset's


def seconds_a_step(step: Callable[[], object], steps: int = MEASURED) -> float:
    """Median seconds that `step` takes."""
    taken = []
    for _ in range(max(1, steps)):
        began = time.monotonic()
        step()
        taken.append(time.monotonic() - began)
    return statistics.median(taken)


def first_schedule_scale(iterations: int, seconds: float, glossy: bool, step: float) -> float:
    """Times the preset's schedules of both stages that so many seconds pay for.

    Args:
        iterations: of the preset's first stage, which shows reflections where `glossy`. step: seconds that one takes in the beginning.
    """
    rest = (REST_GLOSSY if glossy else REST) * step
    preset = (GROWTH * iterations + SECOND) * step
    return min(max((seconds - rest) / preset, SHORTEST), first_longest(iterations))


def first_longest(iterations: int) -> float:
    """The most that `first_pace` gives a preset of so many iterations, whatever the time."""
    return max(1.0, FIRST_LONGEST / iterations)


def second_schedule_scale(settings: SecondStageSettings, seconds: float, glossy: bool, step: float) -> float:
    """Times the preset's schedules of the second stage that so many seconds pay for, where a step of the refinement takes `step`."""
    preset = step * (settings.iterations + (RADIANCE_GLOSSY if glossy else RADIANCE) * settings.radiance_iterations)
    return min(max(seconds / preset, SHORTEST), SECOND_LONGEST) if preset > 0 else 1.0


def times(pace: float, iterations: int) -> int:
    """A schedule `pace` times as long; none stays none."""
    return max(1, round(pace * iterations)) if iterations else 0
