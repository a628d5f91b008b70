# SPDX-License-Identifier: GPL-3.0-or-later
"""Progress recorders: pass progress on to a receiver and record it in a folder."""

from __future__ import annotations

import io
import time
from collections.abc import Callable

import numpy as np

from ..io.atomic import write_atomic
from .event_log import EventLog
from .protocol import Draw, Progress, Sample, TimeLeft
from .terminal import Terminal

EVENT_SECONDS = 0.25  # least time between two step events: thousands a minute would only fill the disk
PREVIEW, SHAPE = "previews/latest.png", "previews/shape.npz"
PREVIEW_SECONDS = 10.0  # least time between two previews; longer where drawing would take more than PREVIEW_FRACTION of the time
PREVIEW_FRACTION = 0.01


class PreviewClock:
    """Times at which a preview is due: every PREVIEW_SECONDS at most, and for at most PREVIEW_FRACTION of the time."""

    def __init__(self) -> None:
        self._next = 0.0

    def write(self, make: Callable[[], None], at_once: bool = False) -> bool:
        """Make a preview if one is due, or at once, and return whether one was made."""
        began = time.monotonic()
        if began < self._next and not at_once:
            return False
        make()
        now = time.monotonic()
        self._next = now + max(PREVIEW_SECONDS, (now - began) / PREVIEW_FRACTION)
        return True


class ProgressRecorder:
    """Progress that is passed on to a receiver and recorded in events.jsonl and log.txt of a folder.

    A file `cancel` or `finish` in the folder cancels the job or finishes its phase early, so that another process can do so.

    Attributes:
        metrics: last value of each metric that was reported.
    """

    def __init__(self, log: EventLog, receiver: Progress) -> None:
        self._log, self._receiver = log, receiver
        self._name, self._left, self._written = "", TimeLeft(0), 0.0
        self._images, self._shapes = PreviewClock(), PreviewClock()
        self.metrics: dict[str, float] = {}

    @property
    def cancelled(self) -> bool:
        """True once the receiver or another process has cancelled the job."""
        return self._receiver.cancelled or (self._log.path / "cancel").exists()

    @property
    def finish_early(self) -> bool:
        """True once the receiver or another process wants the present phase to finish early."""
        return self._receiver.finish_early or (self._log.path / "finish").exists()

    def phase(self, name: str, steps: int) -> None:
        """Begin a phase; a request to finish the previous one early is dropped.

        Args:
            name: of the phase.
            steps: that it has; 0 where unknown.
        """
        (self._log.path / "finish").unlink(missing_ok=True)
        self._name, self._left, self._written = name, TimeLeft(steps), 0.0
        self._log.event(phase=name, step=0, of=steps)
        self._log.log(f"{name}: {steps} steps")
        self._receiver.phase(name, steps)

    def step(self, done: int, **metrics: float) -> None:
        """Report finished steps of the phase.

        Args:
            done: their number.
            **metrics: such as `loss` and `psnr`.
        """
        eta, now = self._left.after(done), time.monotonic()
        self.metrics |= {key: float(value) for key, value in metrics.items()}
        if now - self._written >= EVENT_SECONDS or done >= self._left.steps:
            values = {key: float(value) for key, value in metrics.items()}
            self._log.event(phase=self._name, step=done, of=self._left.steps, **values, eta=None if eta is None else round(eta, 1))
            self._written = now
        self._receiver.step(done, **metrics)

    def message(self, text: str) -> None:
        """Report one line for the user."""
        self._log.event(phase=self._name, message=text)
        self._log.log(text)
        self._receiver.message(text)

    def decided(self, rule: str, on: bool, evidence: str) -> None:
        """Report the decision on a rule such as a skip rule.

        Args:
            rule: name of the setting, without its group.
            on: True where the rule is in force.
            evidence: reason, in one line.
        """
        self._log.rule(rule, on, evidence)
        self._receiver.decided(rule, on, evidence)

    def image(self, draw: Draw) -> None:
        """Draw and write a preview image if one is due."""

        def write() -> None:
            from PIL import Image

            data = io.BytesIO()
            Image.fromarray(draw()).save(data, "PNG")
            self._write(PREVIEW, data.getvalue())

        if self._images.write(write):
            self._log.event(phase=self._name, preview=PREVIEW)

    def shape(self, sample: Sample, at_once: bool = False) -> None:
        """Sample and write the present shape if one is due, or at once."""

        def write() -> None:
            data, arrays = io.BytesIO(), sample()
            np.savez(data, **arrays)
            self._write(SHAPE, data.getvalue())

        self._shapes.write(write, at_once)

    def _write(self, name: str, data: bytes) -> None:
        """Write a file of the folder `previews`."""
        path = self._log.path / name
        path.parent.mkdir(exist_ok=True)
        write_atomic(path, data)


class JobLog(EventLog):
    """Event log of a command that another program started: it has no log.txt, since that program keeps the terminal output."""

    def log(self, text: str) -> None:
        """Discard the line, which the terminal has printed."""


class JobRecorder(ProgressRecorder):
    """Progress of a command on a terminal that another program follows in a folder as well."""

    def __init__(self, log: EventLog, terminal: Terminal) -> None:
        super().__init__(log, terminal)
        self.end_line = terminal.end_line
