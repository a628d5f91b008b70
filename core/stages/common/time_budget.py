# SPDX-License-Identifier: GPL-3.0-or-later
"""Time budget: schedule scales with which a job ends within the time it is given.

The first stage gets what remains after an estimate of the phases of fixed length. The second stage begins when most of the job is
done and gets what then remains, which corrects the errors of that estimate.
"""

from __future__ import annotations

import statistics
import time
from collections.abc import Callable
from typing import Any, Protocol

import torch

from ...machine.backend import wait_for
from ...machine.job_time import fixed_seconds, refinement_step_seconds, schedule_seconds, step_seconds
from ...scene.dataset import Dataset
from ...settings.schema import Settings

MEASURED_STEPS = 20  # steps whose median duration is taken as the cost of a step
# Mean cost of a first-stage step over its cost at the start: SH degrees are added over time, and with several rays per pixel those.
STEP_COST_GROWTH, STEP_COST_GROWTH_SINGLE = 1.4, 1.1
AFTER_FUSION_RATIO = 1.2  # duration of the phases after the second stage over that of the surface fusion
MIN_SCALE = 0.1  # of the preset's schedules
# Longer schedules were measured to fit the images' noise: normals, albedo and relit images get worse again.
MAX_FIRST_STAGE_STEPS = 4500  # unless the preset has more
MAX_SECOND_STAGE_SCALE = 5.0  # of the preset's schedules


class Schedulable(Protocol):
    """Iterative optimisation whose schedule length (`settings.iterations`) can be changed while it runs."""

    @property
    def settings(self) -> Any:
        """Settings of the stage with the number of `iterations`."""

    @property
    def device(self) -> torch.device:
        """Device of the tensors."""
        ...

    def step(self) -> object:
        """Do one step."""

    def reschedule(self, iterations: int) -> None:
        """Continue with a schedule of so many steps in all."""


def seconds_per_step(step: Callable[[], object], steps: int = MEASURED_STEPS) -> float:
    """Return the median duration of a step in seconds.

    Args:
        step: function to measure.
        steps: number of calls, at least 1.
    """
    taken = []
    for _ in range(max(1, steps)):
        began = time.monotonic()
        step()
        taken.append(time.monotonic() - began)
    return statistics.median(taken)


def scale_schedule(
    optimisation: Schedulable, stage: str, deadline: float, scale_for: Callable[[float, float], float], largest: float
) -> tuple[float, str]:
    """Take the first steps of an optimisation to measure their cost, and scale its schedule so that it ends by the deadline.

    Args:
        optimisation: at its start; MEASURED_STEPS steps of it are done.
        stage: name of the stage for the report.
        deadline: seconds on the monotonic clock.
        scale_for: returns the schedule scale for (seconds left, seconds per step).
        largest: schedule scale above which `scale_for` does not go.

    Returns:
        The schedule scale, as a multiple of the preset's length, and a line that reports it.
    """
    step = seconds_per_step(lambda: (optimisation.step(), wait_for(optimisation.device)))
    left, iterations = deadline - time.monotonic(), optimisation.settings.iterations
    schedule_scale = scale_for(left, step)
    optimisation.reschedule(scaled_iterations(schedule_scale, iterations))
    limit = "; a longer one does not help" if schedule_scale == largest else ""
    return schedule_scale, (
        f"{stage}: schedule {schedule_scale:.2f} times as long as the preset's ({left:.0f} s left, {1000 * step:.0f} ms per step{limit})"
    )


def first_stage_schedule_scale(settings: Settings, data: Dataset, seconds: float, step: float) -> float:
    """Return the schedule scale of both stages that fits into a number of seconds.

    The other phases are taken to last as long as `job_time` estimates, on a machine as fast as the measured steps say.

    Args:
        settings: the preset's.
        data: the photographs.
        seconds: time left for the whole job.
        step: measured seconds per step at the start of the first stage.
    """
    mean = step * (STEP_COST_GROWTH if settings.first.subpixels > 1 else STEP_COST_GROWTH_SINGLE)
    speed = mean / step_seconds(settings, data)
    preset = settings.first.iterations * mean + speed * schedule_seconds(settings, data)
    scale = (seconds - speed * fixed_seconds(settings, data)) / preset
    return min(max(scale, MIN_SCALE), first_stage_largest_scale(settings.first.iterations))


def first_stage_largest_scale(iterations: int) -> float:
    """Return the largest value of `first_stage_schedule_scale` for a preset of `iterations` steps, however much time there is."""
    return max(1.0, MAX_FIRST_STAGE_STEPS / iterations)


def second_stage_schedule_scale(settings: Settings, data: Dataset, seconds: float, step: float) -> float:
    """Return the schedule scale of the second stage that fits into a number of seconds.

    Args:
        settings: the preset's.
        data: the photographs.
        seconds: time left for refinement and radiance refit.
        step: measured seconds per step of the refinement.
    """
    preset = step / refinement_step_seconds(settings) * schedule_seconds(settings, data)
    return min(max(seconds / preset, MIN_SCALE), MAX_SECOND_STAGE_SCALE) if preset > 0 else 1.0


def joint_schedule_scale(iterations: int, seconds: float, step: float) -> float:
    """Return the schedule scale of the joint optimisation that fits into a number of seconds, at most the published schedule.

    Args:
        iterations: number of iterations of the schedule.
        seconds: time left for it.
        step: measured seconds per iteration.
    """
    return min(max(seconds / (step * iterations), 1 / iterations), 1.0)


def scaled_iterations(schedule_scale: float, iterations: int) -> int:
    """Scale the length of a schedule.

    Args:
        schedule_scale: factor, > 0.
        iterations: steps of the schedule.

    Returns:
        At least 1 step; 0 where the schedule has none.
    """
    return max(1, round(schedule_scale * iterations)) if iterations else 0
