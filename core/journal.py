# SPDX-License-Identifier: GPL-3.0-or-later
"""Progress on its way to whoever watches, written down in a run folder."""

from __future__ import annotations

import time

from .progress import Progress, TimeLeft
from .run_folder import RunFolder

EVENT_SECONDS = 0.25  # at most one step event in this time: thousands of steps a minute would only fill the disk


class Journal:
    """Passes progress on to a watcher and appends it to events.jsonl and log.txt.

    A file `cancel` or `finish` in the run folder asks for what it is named after: so another process can stop the job.
    """

    def __init__(self, run: RunFolder, watcher: Progress) -> None:
        self._run, self._watcher = run, watcher
        self._name, self._left, self._written = "", TimeLeft(0), 0.0
        self.figures: dict[str, float] = {}  # the last ones that were reported

    @property
    def cancelled(self) -> bool:
        """True once the watcher or another process wants the job to stop."""
        return self._watcher.cancelled or (self._run.path / "cancel").exists()

    @property
    def finish_early(self) -> bool:
        """True once the watcher or another process is content with the present phase."""
        return self._watcher.finish_early or (self._run.path / "finish").exists()

    def phase(self, name: str, steps: int) -> None:
        """A phase begins; a wish to finish the last one early is spent."""
        (self._run.path / "finish").unlink(missing_ok=True)
        self._name, self._left, self._written = name, TimeLeft(steps), 0.0
        self._run.event(phase=name, step=0, of=steps)
        self._run.log(f"{name}: {steps} steps")
        self._watcher.phase(name, steps)

    def step(self, done: int, **figures: float) -> None:
        """So many steps of the phase are done."""
        eta, now = self._left.after(done), time.monotonic()
        self.figures |= {key: float(value) for key, value in figures.items()}
        if now - self._written >= EVENT_SECONDS or done >= self._left.steps:
            values = {key: float(value) for key, value in figures.items()}
            self._run.event(phase=self._name, step=done, of=self._left.steps, **values, eta=None if eta is None else round(eta, 1))
            self._written = now
        self._watcher.step(done, **figures)

    def message(self, text: str) -> None:
        """One line for a person."""
        self._run.event(phase=self._name, message=text)
        self._run.log(text)
        self._watcher.message(text)
