# SPDX-License-Identifier: GPL-3.0-or-later
"""Interfaces between stages and their callers: progress and checkpoints, so that stages depend on neither terminals nor run folders."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any, Protocol

import numpy as np

Draw = Callable[[], np.ndarray]  # draws an image, (H, W, 3) or (H, W, 4) uint8
Sample = Callable[[], dict[str, np.ndarray]]  # samples the present shape, see `Progress.shape`


class Progress(Protocol):
    """Receiver of a job's progress, which can also stop the job."""

    @property
    def cancelled(self) -> bool:
        """True once the user stops the job: the stage writes a checkpoint and raises `errors.Cancelled`."""
        ...

    @property
    def finish_early(self) -> bool:
        """True once the user accepts the present result: an iterative phase ends, and the job continues with the next."""
        ...

    def phase(self, name: str, steps: int) -> None:
        """Begin a phase.

        Args:
            name: of the phase.
            steps: that it has; 0 where unknown.
        """

    def step(self, done: int, **metrics: float) -> None:
        """Report finished steps of the phase.

        Args:
            done: their number.
            **metrics: such as `loss` and `psnr`.
        """

    def message(self, text: str) -> None:
        """Report one line for the user."""

    def decided(self, rule: str, on: bool, evidence: str) -> None:
        """Report the decision on a rule such as a skip rule.

        Args:
            rule: name of the setting, without its group.
            on: True where the rule is in force.
            evidence: reason, in one line.
        """

    def image(self, draw: Draw) -> None:
        """Offer a preview, which is drawn only where the receiver wants one."""

    def shape(self, sample: Sample, at_once: bool = False) -> None:
        """Offer the present shape of the object, which is sampled only where the receiver wants it.

        Args:
            sample: returns position (N, 3) float32 in the world, colour (N, 3) float32 sRGB-encoded in 0..1, centre (3,) of the object,
                to_world (4, 4) from the dataset's own frame to the world; and faces (T, 3) int32 once there is a surface.
            at_once: the receiver should not wait until the next shape is due: there will be none.
        """


class Silent:
    """Progress that is discarded."""

    cancelled = False
    finish_early = False

    def phase(self, name: str, steps: int) -> None:
        """Discard the beginning of a phase.

        Args:
            name: of the phase.
            steps: of the phase.
        """

    def step(self, done: int, **metrics: float) -> None:
        """Discard the number of finished steps.

        Args:
            done: finished steps.
            **metrics: such as `loss`.
        """

    def message(self, text: str) -> None:
        """Discard a message."""

    def decided(self, rule: str, on: bool, evidence: str) -> None:
        """Discard the decision on a rule such as a skip rule.

        Args:
            rule: its name.
            on: True where it is in force.
            evidence: reason, in one line.
        """

    def image(self, draw: Draw) -> None:
        """Discard a preview without drawing it."""

    def shape(self, sample: Sample, at_once: bool = False) -> None:
        """Discard the shape without sampling it."""


class Checkpoint(Protocol):
    """Store of a stage's state, from which the stage can be resumed."""

    def save(self, name: str, state: dict[str, Any]) -> None:
        """Write a state.

        Args:
            name: of the checkpoint.
            state: tensors, arrays, numbers and strings; nested dicts are allowed.
        """

    def load(self, name: str) -> dict[str, Any] | None:
        """Return the state of a checkpoint; None where there is none."""
        ...


class TimeLeft:
    """Estimate of the seconds left in a phase from its recent speed.

    The first report only starts the clock: its steps may have compiled kernels or come from a checkpoint.
    """

    def __init__(self, steps: int) -> None:
        self.steps = steps
        self._marks: list[tuple[float, int]] = []  # seconds, finished steps

    def after(self, done: int) -> float | None:
        """Return the seconds left after `done` steps; None until a second report shows the speed."""
        if done <= 0:
            return None
        now = time.monotonic()
        if not self._marks or (now - self._marks[-1][0] >= 0.5 and done > self._marks[-1][1]):
            self._marks = [*self._marks[-20:], (now, done)]
        then, before = self._marks[0]
        return (self.steps - done) * (now - then) / (done - before) if done > before else None
