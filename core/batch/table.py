# SPDX-License-Identifier: GPL-3.0-or-later
"""The table of a batch: kept up to date on a terminal, a line for each change where the output goes to a file."""

from __future__ import annotations

import shutil
import sys
import time
from collections import Counter
from collections.abc import Sequence
from typing import TextIO

from ..progress.terminal import clock
from .job_state import Progress, State

LIVE_SECONDS, PLAIN_SECONDS = 0.5, 60.0  # between two looks; between two lines on a job that is still in the same phase
ORDER = ("running", "failed", "cancelled", "waiting", "done")  # what is shown where there is no room for all


class BatchTable:
    """Shows rows of a name, a state and, of those that run, how far they are."""

    def __init__(self, stream: TextIO | None = None) -> None:
        self._stream = stream or sys.stderr
        self._live = self._stream.isatty()
        self._lines, self._looked = 0, 0.0
        self._said: dict[str, tuple[str, float]] = {}

    def show(self, rows: Sequence[tuple[str, State, Progress]], last: bool = False) -> None:
        """Bring it up to date; a cheap call where nothing is due."""
        now = time.monotonic()
        if not last and now - self._looked < LIVE_SECONDS:
            return
        self._looked = now
        if self._live:
            self._draw(rows, last)
        else:
            self._tell(rows, now)

    def _draw(self, rows: Sequence[tuple[str, State, Progress]], last: bool) -> None:
        columns, height = shutil.get_terminal_size()
        room = len(rows) if last else max(1, height - 2)
        chosen = sorted(rows, key=lambda row: ORDER.index(row[1].state))[:room] if len(rows) > room else rows
        lines = [*(row_line(*row)[: columns - 1] for row in chosen), summary(rows)[: columns - 1]]
        up = f"\x1b[{self._lines}A" if self._lines else ""
        text = "".join(f"\x1b[2K{line}\n" for line in lines)
        print(f"{up}{text}\x1b[J", end="", file=self._stream, flush=True)
        self._lines = len(lines)

    def _tell(self, rows: Sequence[tuple[str, State, Progress]], now: float) -> None:
        for name, state, progress in rows:
            said, when = self._said.get(name, ("waiting", 0.0))
            stage = f"{state.state} {progress.phase}" if state.state == "running" else state.state
            if stage != said or (state.state == "running" and now - when > PLAIN_SECONDS):
                self._said[name] = (stage, now)
                print(row_line(name, state, progress), file=self._stream, flush=True)


def row_line(name: str, state: State, progress: Progress) -> str:
    """One job in one line."""
    said = {"done": f"in {clock(state.seconds)}", "failed": state.error, "running": doing(progress)}.get(state.state, "")
    return f"{name:<20} {state.state:<9} {said}".rstrip()


def doing(progress: Progress) -> str:
    """Phase, share and time left of what runs."""
    share = f" {min(progress.step / progress.of, 1):4.0%}" if progress.of > 0 else ""
    left = f"  {clock(progress.eta)} left" if progress.eta else ""
    return f"{progress.phase or 'starting'}{share}{left}"


def summary(rows: Sequence[tuple[str, State, Progress]]) -> str:
    """How many jobs are in which state."""
    counts = Counter(state.state for _, state, _ in rows)
    order = ("done", "running", "waiting", "failed", "cancelled")
    return f"{len(rows)} jobs: " + ", ".join(f"{counts[state]} {state}" for state in order if counts[state])
