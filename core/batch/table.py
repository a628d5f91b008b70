# SPDX-License-Identifier: GPL-3.0-or-later
"""Table of a batch's jobs: redrawn in place on a terminal, one line per change where the output goes to a file."""

from __future__ import annotations

import shutil
import sys
import time
from collections import Counter
from collections.abc import Sequence
from typing import TextIO

from ..progress.terminal import clock
from .job_state import JobProgress, State

LIVE_SECONDS, PLAIN_SECONDS = 0.5, 60.0  # between two updates; between two lines about a job that is still in the same phase
# Of the rows, by state, where the terminal has fewer lines than there are jobs.
ORDER = ("running", "failed", "cancelled", "waiting", "done")


class BatchTable:
    """Table with a row for each job: name, state and, while it runs, its progress.

    Args:
        stream: to print to; None: stderr.
    """

    def __init__(self, stream: TextIO | None = None) -> None:
        self._stream = stream or sys.stderr
        self._live = self._stream.isatty()
        self._lines, self._updated = 0, 0.0
        self._printed: dict[str, tuple[str, float]] = {}

    def show(self, rows: Sequence[tuple[str, State, JobProgress]], last: bool = False) -> None:
        """Update the output; returns at once where the last update was less than LIVE_SECONDS ago.

        Args:
            rows: name, state and progress of each job.
            last: show all rows now, as nothing follows.
        """
        now = time.monotonic()
        if not last and now - self._updated < LIVE_SECONDS:
            return
        self._updated = now
        if self._live:
            self._draw(rows, last)
        else:
            self._print_changes(rows, now)

    def _draw(self, rows: Sequence[tuple[str, State, JobProgress]], last: bool) -> None:
        """Redraw the table over its last version; as many rows as fit, unless it is the last time."""
        columns, height = shutil.get_terminal_size()
        limit = len(rows) if last else max(1, height - 2)
        chosen = sorted(rows, key=lambda row: ORDER.index(row[1].state))[:limit] if len(rows) > limit else rows
        lines = [*(row_line(*row)[: columns - 1] for row in chosen), summary(rows)[: columns - 1]]
        up = f"\x1b[{self._lines}A" if self._lines else ""
        text = "".join(f"\x1b[2K{line}\n" for line in lines)
        print(f"{up}{text}\x1b[J", end="", file=self._stream, flush=True)
        self._lines = len(lines)

    def _print_changes(self, rows: Sequence[tuple[str, State, JobProgress]], now: float) -> None:
        """Print a line for each job whose state or phase has changed, or that has been silent for PLAIN_SECONDS."""
        for name, state, progress in rows:
            before, when = self._printed.get(name, ("waiting", 0.0))
            stage = f"{state.state} {progress.phase}" if state.state == "running" else state.state
            if stage != before or (state.state == "running" and now - when > PLAIN_SECONDS):
                self._printed[name] = (stage, now)
                print(row_line(name, state, progress), file=self._stream, flush=True)


def row_line(name: str, state: State, progress: JobProgress) -> str:
    """Format one job as a line of text.

    Args:
        name: of the job.
        state: of the job.
        progress: of its running command.
    """
    details = {"done": f"in {clock(state.seconds)}", "failed": state.error, "running": progress_text(progress)}.get(state.state, "")
    return f"{name:<20} {state.state:<9} {details}".rstrip()


def progress_text(progress: JobProgress) -> str:
    """Format phase, fraction done and time left of a running job."""
    fraction = f" {min(progress.step / progress.of, 1):4.0%}" if progress.of > 0 else ""
    left = f"  {clock(progress.eta)} left" if progress.eta else ""
    return f"{progress.phase or 'starting'}{fraction}{left}"


def summary(rows: Sequence[tuple[str, State, JobProgress]]) -> str:
    """Format the number of jobs in each state."""
    counts = Counter(state.state for _, state, _ in rows)
    order = ("done", "running", "waiting", "failed", "cancelled")
    return f"{len(rows)} jobs: " + ", ".join(f"{counts[state]} {state}" for state in order if counts[state])
