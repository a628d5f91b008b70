# SPDX-License-Identifier: GPL-3.0-or-later
"""State and progress of jobs, kept in files that every machine of a batch can read."""

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
    """State of a job.

    Attributes:
        state: "waiting", "running", "done", "failed" or "cancelled".
        error: reason of a failure, one line.
        seconds: run time so far, of all attempts.
        finished: arguments of the steps that were completed, in order.
    """

    state: str = "waiting"
    error: str = ""
    seconds: float = 0.0
    finished: tuple[tuple[str, ...], ...] = ()


@dataclass(frozen=True)
class JobProgress:
    """Progress of a running command, from its last event.

    Attributes:
        phase: name of the phase.
        step: steps done of the phase.
        of: number of the phase's steps.
        eta: seconds left, where known.
    """

    phase: str = ""
    step: int = 0
    of: int = 0
    eta: float | None = None


class JobFolder:
    """Folder of one job: state.json, lock, log.txt with the output of its commands, events.jsonl of the command that runs."""

    def __init__(self, path: Path) -> None:
        self.path = path

    def prepare(self) -> None:
        """Create the folder; remove requests to cancel and events of earlier attempts."""
        self.path.mkdir(parents=True, exist_ok=True)
        for name in ("cancel", "events.jsonl"):
            (self.path / name).unlink(missing_ok=True)

    def read(self) -> State:
        """Read the saved state; a job without one, or with a damaged one, is "waiting"."""
        values = _json(self.path / "state.json")
        try:
            steps = tuple(tuple(str(word) for word in step) for step in values.get("finished", []))
            return State(str(values.get("state", "waiting")), str(values.get("error", "")), float(values.get("seconds", 0)), steps)
        except (TypeError, ValueError):
            return State()

    def write(self, state: State) -> None:
        """Save the state atomically."""
        write_atomic(self.path / "state.json", json.dumps(asdict(state), indent=1).encode())

    def progress(self) -> JobProgress:
        """Read the progress of the command that runs."""
        try:
            with (self.path / "events.jsonl").open("rb") as file:
                file.seek(0, 2)
                file.seek(max(0, file.tell() - TAIL_BYTES))
                lines = file.read().decode("utf-8", "replace").splitlines()
        except OSError:
            return JobProgress()
        for line in reversed(lines):
            event = _parsed(line)
            if "of" in event:
                return JobProgress(str(event.get("phase", "")), int(event.get("step") or 0), int(event["of"] or 0), event.get("eta"))
        return JobProgress()

    def last_message(self, since: int) -> str:
        """Return the last message of irgspp in log.txt after `since` bytes, or else the last line of any kind."""
        try:
            text = (self.path / "log.txt").read_bytes()[since:].decode("utf-8", "replace")
        except OSError:
            return ""
        lines = [line.strip() for line in text.replace("\r", "\n").splitlines() if line.strip()]
        own = [line.removeprefix("irgspp: ") for line in lines if line.startswith("irgspp: ")]
        return own[-1] if own else lines[-1] if lines else ""


def is_complete(job: Job, step: Sequence[str], state: State) -> bool:
    """Return True if a step was completed and its output still exists.

    Args:
        job: that the step belongs to.
        step: arguments of its command.
        state: of the job.
    """
    if tuple(step) not in state.finished:
        return False
    if tuple(step) == job.steps[0]:
        return (job.run / "run.json").is_file() and read_run(job.run)["status"] == "done"
    return all(target.exists() for target in targets(job, step))


def _json(path: Path) -> dict[str, Any]:
    """Read a JSON object; empty where the file is missing or damaged."""
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
