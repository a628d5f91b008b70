# SPDX-License-Identifier: GPL-3.0-or-later
"""What long work tells and asks: an interface, so that stages know neither terminals nor run folders."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any, Protocol

import numpy as np

Draw = Callable[[], np.ndarray]  # makes an image, (H, W, 3) or (H, W, 4) uint8


class Progress(Protocol):
    """Receives the progress of a job.

    `phase` opens a phase of a known number of steps; `step` reports the number of steps done, with figures such as `loss` and
    `psnr`; `message` is one line for a person; `decided` says whether a rule that leaves work out is in force, and why; `image`
    offers an image of what is there, drawn only where one is wanted.
    `cancelled` turns True when the user wants the work to stop: the worker saves what it has and raises `errors.Cancelled`.
    `finish_early` turns True when the user is content with what is there: an iterative phase stops and the work goes on with
    the next one.
    """

    @property
    def cancelled(self) -> bool: ...

    @property
    def finish_early(self) -> bool: ...

    def phase(self, name: str, steps: int) -> None: ...

    def step(self, done: int, **figures: float) -> None: ...

    def message(self, text: str) -> None: ...

    def decided(self, rule: str, on: bool, evidence: str) -> None: ...

    def image(self, draw: Draw) -> None: ...


class Silent:
    """Progress that nobody watches."""

    cancelled = False
    finish_early = False

    def phase(self, name: str, steps: int) -> None:
        """Ignored."""

    def step(self, done: int, **figures: float) -> None:
        """Ignored."""

    def message(self, text: str) -> None:
        """Ignored."""

    def decided(self, rule: str, on: bool, evidence: str) -> None:
        """Ignored."""

    def image(self, draw: Draw) -> None:
        """Not drawn."""


class Checkpoint(Protocol):
    """Where a stage keeps enough to go on: a dict of tensors, arrays, numbers and strings (nested dicts allowed) under a name."""

    def save(self, name: str, state: dict[str, Any]) -> None: ...

    def load(self, name: str) -> dict[str, Any] | None: ...


class TimeLeft:
    """Estimates the seconds left in a phase from its recent speed (the first steps of a phase are often the slow ones)."""

    def __init__(self, steps: int) -> None:
        self.steps, self._began, self._marks = steps, time.monotonic(), [(time.monotonic(), 0)]

    def after(self, done: int) -> float | None:
        """Seconds left after `done` steps, or None while nothing is known."""
        now = time.monotonic()
        if now - self._marks[-1][0] >= 0.5 and done > self._marks[-1][1]:
            self._marks = [*self._marks[-20:], (now, done)]
        (then, before) = self._marks[0]
        return (self.steps - done) * (now - then) / (done - before) if done > before else None
