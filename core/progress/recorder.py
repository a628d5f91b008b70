# SPDX-License-Identifier: GPL-3.0-or-later
"""Progress on its way to whoever watches, written down in a folder."""

from __future__ import annotations

import io
import time

from ..io.atomic import write_atomic
from .event_log import EventLog
from .protocol import Draw, Progress, TimeLeft
from .terminal import Terminal

EVENT_SECONDS = 0.25  # at most one step event in this time: thousands of steps a minute would only fill the disk
PREVIEW = "previews/latest.png"
PREVIEW_SECONDS = 10.0  # between two previews, and more where drawing one takes more than PREVIEW_SHARE of the time
PREVIEW_SHARE = 0.01


class ProgressRecorder:
    """Passes progress on to a watcher and appends it to events.jsonl and log.txt of a folder.

    A file `cancel` or `finish` in the folder asks for what it is named after: so another process can stop the job.
    """

    def __init__(self, notes: EventLog, watcher: Progress) -> None:
        self._notes, self._watcher = notes, watcher
        self._name, self._left, self._written, self._next_image = "", TimeLeft(0), 0.0, 0.0
        self.figures: dict[str, float] = {}  # the last ones that were reported

    @property
    def cancelled(self) -> bool:
        """True once the watcher or another process wants the job to stop."""
        return self._watcher.cancelled or (self._notes.path / "cancel").exists()

    @property
    def finish_early(self) -> bool:
        """True once the watcher or another process is content with the present phase."""
        return self._watcher.finish_early or (self._notes.path / "finish").exists()

    def phase(self, name: str, steps: int) -> None:
        """A phase begins; a wish to finish the last one early is spent."""
        (self._notes.path / "finish").unlink(missing_ok=True)
        self._name, self._left, self._written = name, TimeLeft(steps), 0.0
        self._notes.event(phase=name, step=0, of=steps)
        self._notes.log(f"{name}: {steps} steps")
        self._watcher.phase(name, steps)

    def step(self, done: int, **figures: float) -> None:
        """So many steps of the phase are done."""
        eta, now = self._left.after(done), time.monotonic()
        self.figures |= {key: float(value) for key, value in figures.items()}
        if now - self._written >= EVENT_SECONDS or done >= self._left.steps:
            values = {key: float(value) for key, value in figures.items()}
            self._notes.event(phase=self._name, step=done, of=self._left.steps, **values, eta=None if eta is None else round(eta, 1))
            self._written = now
        self._watcher.step(done, **figures)

    def message(self, text: str) -> None:
        """One line for a person."""
        self._notes.event(phase=self._name, message=text)
        self._notes.log(text)
        self._watcher.message(text)

    def decided(self, rule: str, on: bool, evidence: str) -> None:
        """A rule that leaves work out is in force, or not."""
        self._notes.rule(rule, on, evidence)
        self._watcher.decided(rule, on, evidence)

    def image(self, draw: Draw) -> None:
        """Keep an image of what is there now and then, so rarely that it costs next to nothing."""
        began = time.monotonic()
        if began < self._next_image:
            return
        from PIL import Image

        data = io.BytesIO()
        Image.fromarray(draw()).save(data, "PNG")
        (self._notes.path / PREVIEW).parent.mkdir(exist_ok=True)
        write_atomic(self._notes.path / PREVIEW, data.getvalue())
        self._notes.event(phase=self._name, preview=PREVIEW)
        now = time.monotonic()
        self._next_image = now + max(PREVIEW_SECONDS, (now - began) / PREVIEW_SHARE)


class JobLog(EventLog):
    """The notes of a command that another program started: its log is the terminal's own output, which that program keeps."""

    def log(self, text: str) -> None:
        """Said on the terminal already."""


class JobRecorder(ProgressRecorder):
    """A terminal's progress that another program watches as well."""

    def __init__(self, notes: EventLog, terminal: Terminal) -> None:
        super().__init__(notes, terminal)
        self.end_line = terminal.end_line
