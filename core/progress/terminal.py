# SPDX-License-Identifier: GPL-3.0-or-later
"""Progress on a terminal: one line that is kept up to date, or a line every few seconds where the output goes to a file."""

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

from .protocol import Draw, TimeLeft

BAR = 24
LIVE_SECONDS, PLAIN_SECONDS = 0.1, 5.0
FIGURES = {"loss": ("loss", "{:.4f}"), "psnr": ("PSNR", "{:.2f} dB"), "gaussians": ("Gaussians", "{:.0f}")}


class Terminal:
    """Shows progress on a stream (stderr); inside `signals()`, Ctrl-C sets `cancelled`."""

    finish_early = False

    def __init__(self, stream: TextIO | None = None) -> None:
        self._stream = stream or sys.stderr
        self._live = self._stream.isatty()
        self.cancelled = False
        self._name, self._left, self._shown, self._done, self._width = "", TimeLeft(0), 0.0, -1, 0

    def phase(self, name: str, steps: int) -> None:
        """A phase begins."""
        self.end_line()
        self._name, self._left, self._shown, self._done = name, TimeLeft(steps), time.monotonic(), 0
        if self._live or steps <= 0:
            self._show(progress_line(name, 0, steps, None, {}))

    def step(self, done: int, **figures: float) -> None:
        """So many steps are done; shown now and then, and at the end of the phase."""
        left, now = self._left.after(done), time.monotonic()
        last = done >= self._left.steps > self._done
        self._done = done
        if last or now - self._shown >= (LIVE_SECONDS if self._live else PLAIN_SECONDS):
            self._shown = now
            self._show(progress_line(self._name, done, self._left.steps, left, figures))

    def message(self, text: str) -> None:
        """One line for a person."""
        self.end_line()
        print(text, file=self._stream, flush=True)

    def decided(self, rule: str, on: bool, evidence: str) -> None:
        """One line on a rule that leaves work out."""
        self.message(f"skip.{rule} {'on' if on else 'off'}: {evidence}")

    def image(self, draw: Draw) -> None:
        """Terminals show none."""

    def end_line(self) -> None:
        """Leave the line that is kept up to date, so that others may print."""
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
        """Within the block the first Ctrl-C (or SIGTERM) asks the work to stop, the second ends the process at once."""
        kinds = (signal.SIGINT, signal.SIGTERM)
        before = {kind: signal.signal(kind, self._stop) for kind in kinds}
        try:
            yield self
        finally:
            for kind, handler in before.items():
                signal.signal(kind, handler)

    def _stop(self, number: int, frame: FrameType | None) -> None:
        if self.cancelled:
            os._exit(130)
        self.cancelled = True
        # os.write: a handler must not enter a print that it interrupted.
        os.write(2, b"\nstopping, what is done will be saved; Ctrl-C again ends at once\n")


def progress_line(name: str, done: int, steps: int, left: float | None, figures: dict[str, float]) -> str:
    """Phase, bar, step, figures and time left in one line."""
    if steps <= 0:
        return name
    share = min(done / steps, 1.0)
    parts = [f"{name:<14}[{'#' * round(BAR * share):.<{BAR}}] {share:4.0%} {done}/{steps}"]
    parts += [f"{label} {form.format(figures[key])}" for key, (label, form) in FIGURES.items() if key in figures]
    if left is not None and done < steps:
        parts.append(f"{clock(left)} left")
    return "  ".join(parts)


def clock(seconds: float) -> str:
    """Seconds as m:ss or h:mm:ss."""
    minutes, rest = divmod(round(seconds), 60)
    hours, minutes = divmod(minutes, 60)
    return f"{hours}:{minutes:02}:{rest:02}" if hours else f"{minutes}:{rest:02}"
