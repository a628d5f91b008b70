# SPDX-License-Identifier: GPL-3.0-or-later
"""What is known of a job while it waits, runs and after: files that every machine of a batch can read."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from ..run_folder import read_run, write_atomic
from .jobs import Job, targets

TAIL_BYTES = 4096


@dataclass(frozen=True)
class State:
    """How far a job is: "waiting", "running", "done", "failed" (`error` says why, in a line) or "cancelled".

    `finished`: the words of the steps that were completed, in order; `seconds`: what it took so far, of all attempts.
    """

    state: str = "waiting"
    error: str = ""
    seconds: float = 0.0
    finished: tuple[tuple[str, ...], ...] = ()


@dataclass(frozen=True)
class Progress:
    """The last thing that a running command said."""

    phase: str = ""
    step: int = 0
    of: int = 0
    eta: float | None = None


class JobFolder:
    """The folder of one job's notes: state.json, lock, log.txt with all that its commands print, events.jsonl of the one that runs."""

    def __init__(self, path: Path) -> None:
        self.path = path

    def prepare(self) -> None:
        """Make it, and take old wishes back."""
        self.path.mkdir(parents=True, exist_ok=True)
        for name in ("cancel", "events.jsonl"):
            (self.path / name).unlink(missing_ok=True)

    def read(self) -> State:
        """What is noted; a job that nobody noted anything of waits."""
        values = _json(self.path / "state.json")
        try:
            steps = tuple(tuple(str(word) for word in step) for step in values.get("finished", []))
            return State(str(values.get("state", "waiting")), str(values.get("error", "")), float(values.get("seconds", 0)), steps)
        except (TypeError, ValueError):
            return State()

    def write(self, state: State) -> None:
        """Replace what is noted."""
        write_atomic(self.path / "state.json", json.dumps(asdict(state), indent=1).encode())

    def progress(self) -> Progress:
        """Of the command that runs."""
        try:
            with (self.path / "events.jsonl").open("rb") as file:
                file.seek(0, 2)
                file.seek(max(0, file.tell() - TAIL_BYTES))
                lines = file.read().decode("utf-8", "replace").splitlines()
        except OSError:
            return Progress()
        for line in reversed(lines):
            event = _parsed(line)
            if "of" in event:
                return Progress(str(event.get("phase", "")), int(event.get("step") or 0), int(event["of"] or 0), event.get("eta"))
        return Progress()

    def last_words(self, since: int) -> str:
        """The last line of log.txt after so many bytes; the program's own word where there is one."""
        try:
            text = (self.path / "log.txt").read_bytes()[since:].decode("utf-8", "replace")
        except OSError:
            return ""
        lines = [line.strip() for line in text.replace("\r", "\n").splitlines() if line.strip()]
        own = [line.removeprefix("irgspp: ") for line in lines if line.startswith("irgspp: ")]
        return own[-1] if own else lines[-1] if lines else ""


def is_there(job: Job, step: Sequence[str], state: State) -> bool:
    """True where a step was completed and what it made has not been taken away since."""
    if tuple(step) not in state.finished:
        return False
    if tuple(step) == job.steps[0]:
        return (job.run / "run.json").is_file() and read_run(job.run)["status"] == "done"
    return all(target.exists() for target in targets(job, step))


def _json(path: Path) -> dict[str, Any]:
    try:
        return _parsed(path.read_text("utf-8"))
    except OSError:
        return {}


def _parsed(text: str) -> dict[str, Any]:
    try:
        values = json.loads(text)
    except ValueError:
        return {}
    return values if isinstance(values, dict) else {}
