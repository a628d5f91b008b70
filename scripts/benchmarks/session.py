# SPDX-License-Identifier: GPL-3.0-or-later
"""Session of a benchmark: does all tasks in order, skips finished ones, records failures and shows the remaining time."""

from __future__ import annotations

import sys
import time
import traceback
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from types import ModuleType
from typing import TextIO

import numpy as np
from irgspp.core.progress.terminal import clock
from PIL import Image

from .bench import Bench, Scene
from .section import Task
from .store import EVERYWHERE, Record, Store

LIVE_SECONDS, PLAIN_SECONDS = 0.5, 30.0


@dataclass(frozen=True, eq=False)
class Step:
    """Task with its section and scene."""

    section: str
    scene: Scene | None
    task: Task

    @property
    def key(self) -> tuple[str, str, str]:
        """Key of the task's record."""
        return (self.section, self.scene.name if self.scene else EVERYWHERE, self.task.configuration)


def steps_of(bench: Bench, sections: Sequence[ModuleType]) -> list[Step]:
    """Return the tasks of all sections and scenes in order.

    Args:
        bench: options and scenes.
        sections: modules of the sections.
    """
    return [
        Step(section.NAME, scene, task)
        for section in sections
        for scene in ([None] if section.ONCE else bench.scenes)
        for task in section.tasks(bench, scene)
    ]


def expected_seconds(bench: Bench, steps: Sequence[Step]) -> list[float]:
    """Return the expected seconds of each step on two cores.

    A reconstruction counts where it is needed first, and not at all where it exists.

    Args:
        bench: options and reconstructions.
        steps: steps in order.
    """
    counted, seconds = set(), []
    for step in steps:
        own = step.task.seconds
        for plan in step.task.runs:
            assert step.scene is not None
            if (step.scene.name, plan.label) not in counted and not bench.has_run(step.scene, plan):
                own += plan.seconds
            counted.add((step.scene.name, plan.label))
        seconds.append(own)
    return seconds


class Session:
    """Worker of the steps that shows its progress on a terminal."""

    def __init__(self, bench: Bench, store: Store, stream: TextIO | None = None) -> None:
        self.bench, self.store, self._stream = bench, store, stream or sys.stderr
        self._live = self._stream.isatty()
        self._shown, self._width, self._line = 0.0, 0, ""
        self._began, self._left, self._own = 0.0, 0.0, 0.0
        bench.on_tick = self._tick

    def work(self, steps: Sequence[Step]) -> int:
        """Do all steps that are not done, and return how many failed.

        KeyboardInterrupt passes; everything done so far is in the store.

        Args:
            steps: steps in order.
        """
        missing = [step for step in steps if not self.store.done(step.key)]
        seconds = expected_seconds(self.bench, missing)
        self.say(f"{len(steps)} measurements, {len(steps) - len(missing)} of them done; about {clock(sum(seconds))} left on two idle cores")
        spent, planned, failures = 0.0, 0.0, 0
        for number, (step, own) in enumerate(zip(missing, seconds, strict=True), 1):
            time_scale = spent / planned if planned > 60 else 1.0
            self._left, self._own, self._began = time_scale * sum(seconds[number - 1 :]), time_scale * own, time.monotonic()
            self._line = f"{number}/{len(missing)} {' '.join(step.key)}"
            self._tick(True)
            record = self._measured(step)
            failures += record.status == "failed"
            self.store.add(record)
            spent, planned = spent + record.seconds, planned + own
        self._end_line()
        return failures

    def _measured(self, step: Step) -> Record:
        """Do a step and return its record; an exception makes it a failed one."""
        try:
            found = step.task.work()
            figures = {name: _plain(value) for name, value in found.figures.items()}
            files = {name: self._save_image(step, name, image) for name, image in found.images.items()}
            record = Record(*step.key, figures=figures, counted=found.counted, images=files)
        except Exception as error:
            line = f"{type(error).__name__}: {' '.join(str(error).split())}"
            self.say(f"failed: {' '.join(step.key)}: {line}")
            with (self.bench.folder / "failures.log").open("a", encoding="utf-8") as log:
                log.write(f"{' '.join(step.key)}\n{traceback.format_exc()}\n")
            record = Record(*step.key, status="failed", error=line)
        return replace(record, seconds=round(time.monotonic() - self._began, 3), environment=self.store.current)

    def _save_image(self, step: Step, name: str, image: np.ndarray) -> str:
        """Write an image as a PNG file and return its path relative to the store's folder."""
        file = Path("pictures", "-".join("".join(c if c.isalnum() else "_" for c in part) for part in (*step.key, name)) + ".png")
        (self.store.folder / "pictures").mkdir(parents=True, exist_ok=True)
        Image.fromarray(image).save(self.store.folder / file)
        return file.as_posix()

    # --- progress line

    def say(self, text: str) -> None:
        """Print a line that stays on the terminal."""
        self._end_line()
        print(text, file=self._stream, flush=True)

    def _tick(self, new: bool = False) -> None:
        """Update the progress line, or print it now and then where there is no terminal."""
        now = time.monotonic()
        if now - self._shown < (LIVE_SECONDS if self._live else PLAIN_SECONDS) and not (new and self._live):
            return
        self._shown, here = now, now - self._began
        line = f"{self._line}  {clock(here)} of {clock(self._own)}, {clock(max(self._left - here, 0))} left"
        if not self._live:
            print(line, file=self._stream, flush=True)
            return
        print("\r" + line.ljust(self._width), end="", file=self._stream, flush=True)
        self._width = len(line)

    def _end_line(self) -> None:
        """End the progress line."""
        if self._live and self._width:
            print(file=self._stream, flush=True)
        self._width = 0


def _plain(value: object) -> object:
    """Return a number that JSON can hold; NaN and infinity become text, which no chart shows."""
    if isinstance(value, np.generic):
        value = value.item()
    if isinstance(value, float) and not np.isfinite(value):
        return str(value)
    return value
