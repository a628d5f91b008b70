# SPDX-License-Identifier: GPL-3.0-or-later
"""Progress on a terminal: one line that is updated in place, or a line every few seconds where the output goes to a file."""

from __future__ import annotations

import os
import shutil
import signal
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType
from typing import TextIO

from .protocol import Draw, Sample, TimeLeft

BAR = 24  # characters
LIVE_SECONDS, PLAIN_SECONDS = 0.1, 5.0  # least time between two updates, on a terminal and in a file
METRICS = {"loss": ("loss", "{:.4f}"), "psnr": ("PSNR", "{:.2f} dB"), "gaussians": ("Gaussians", "{:.0f}")}


class Terminal:
    """Progress on a text stream (stderr by default); inside `signals()`, Ctrl-C sets `cancelled`."""

    finish_early = False

    def __init__(self, stream: TextIO | None = None) -> None:
        self._stream = stream or sys.stderr
        self._live = self._stream.isatty()
        self.cancelled = False
        self._name, self._left, self._shown, self._done, self._width = "", TimeLeft(0), 0.0, -1, 0

    def phase(self, name: str, steps: int) -> None:
        """Begin a phase.

        Args:
            name: of the phase.
            steps: that it has; 0 where unknown.
        """
        self.end_line()
        self._name, self._left, self._shown, self._done = name, TimeLeft(steps), time.monotonic(), 0
        if self._live or steps <= 0:
            self._show(progress_line(name, 0, steps, None, {}))

    def step(self, done: int, **metrics: float) -> None:
        """Report finished steps; the line is updated after LIVE_SECONDS or PLAIN_SECONDS, and at the end of the phase.

        Args:
            done: their number.
            **metrics: such as `loss` and `psnr`.
        """
        left, now = self._left.after(done), time.monotonic()
        last = done >= self._left.steps > self._done
        self._done = done
        if last or now - self._shown >= (LIVE_SECONDS if self._live else PLAIN_SECONDS):
            self._shown = now
            self._show(progress_line(self._name, done, self._left.steps, left, metrics))

    def message(self, text: str) -> None:
        """Print one line for the user."""
        self.end_line()
        print(text, file=self._stream, flush=True)

    def decided(self, rule: str, on: bool, evidence: str) -> None:
        """Print the decision on a rule such as a skip rule.

        Args:
            rule: name of the setting, without its group.
            on: True where the rule is in force.
            evidence: reason, in one line.
        """
        self.message(f"{rule} {'on' if on else 'off'}: {evidence}")

    def image(self, draw: Draw) -> None:
        """Ignore a preview, which a terminal can't show."""

    def shape(self, sample: Sample, at_once: bool = False) -> None:
        """Ignore a shape, which a terminal can't show."""

    def end_line(self) -> None:
        """End the line that is updated in place, so that something else can be printed."""
        if self._live and self._width:
            print(file=self._stream, flush=True)
        self._width = 0

    def _show(self, line: str) -> None:
        if not self._live:
            print(line, file=self._stream, flush=True)
            return
        line = line[: shutil.get_terminal_size().columns - 1]
        print("\r" + line.ljust(self._width), end="", file=self._stream, flush=True)  # blanks instead of escape codes: any console
        self._width = len(line)

    @contextmanager
    def signals(self) -> Iterator[Terminal]:
        """Handle Ctrl-C and SIGTERM in the block: the first cancels the job, the second ends the process at once."""
        before = {number: signal.signal(number, self._stop) for number in (signal.SIGINT, signal.SIGTERM)}
        try:
            yield self
        finally:
            for number, handler in before.items():
                signal.signal(number, handler)

    def _stop(self, number: int, frame: FrameType | None) -> None:
        if self.cancelled:
            os._exit(130)
        self.cancelled = True
        # os.write: a signal handler must not enter a print that it interrupted.
        os.write(2, b"\nstopping: saving what is finished; press Ctrl-C again to end at once\n")


def progress_line(name: str, done: int, steps: int, left: float | None, metrics: dict[str, float]) -> str:
    """Return phase, bar, step, metrics and time left in one line.

    Args:
        name: of the phase.
        done: finished steps.
        steps: of the phase; 0 where unknown, which gives the name alone.
        left: seconds left, where known.
        metrics: values by name; the line has those of METRICS.
    """
    if steps <= 0:
        return name
    fraction = min(done / steps, 1.0)
    parts = [f"{name:<14}[{'#' * round(BAR * fraction):.<{BAR}}] {fraction:4.0%} {done}/{steps}"]
    parts += [f"{label} {form.format(metrics[key])}" for key, (label, form) in METRICS.items() if key in metrics]
    if left is not None and done < steps:
        parts.append(f"{clock(left)} left")
    return "  ".join(parts)


def clock(seconds: float) -> str:
    """Return seconds as m:ss or h:mm:ss."""
    minutes, rest = divmod(round(seconds), 60)
    hours, minutes = divmod(minutes, 60)
    return f"{hours}:{minutes:02}:{rest:02}" if hours else f"{minutes}:{rest:02}"
