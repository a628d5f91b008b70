# SPDX-License-Identifier: GPL-3.0-or-later
"""Job of the engine: its command, its progress, and the folder in which both are kept after Blender has ended."""

from __future__ import annotations

import json
import os
import secrets
import time
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from ...core.errors import IrgsppError
from ...core.io.atomic import replace

UNFINISHED = ("queued", "running")
STORED = ("id", "kind", "title", "program", "arguments", "on_done", "data", "state", "owner", "made", "began", "ended", "error", "message")
TAIL_BYTES = 65536  # at the end of events.jsonl, from which the progress is read after a restart
LOG_LINES = 12


@dataclass(eq=False)
class Job:
    """A job of the engine.

    Attributes:
        id: name of its private folder.
        kind: "reconstruct", "demo", "capture", "render", "bake", "export", "inspect", "check" or "install".
        title: text in the list of jobs.
        folder: folder that it reads or writes, such as the run folder.
        notes: its private folder: events.jsonl, log.txt, output.txt (stdout), the request files `cancel` and `finish`, and job.json.
        program: "engine", or the path of a script that Blender's own Python runs.
        arguments: command-line arguments of `irgspp`, or of the script.
        on_done: name in `queue.ON_DONE` of the function that Blender calls when the job is done.
        data: JSON data for that function.
        state: "queued", "running", "done", "failed", "cancelled" or "lost" (it ended unobserved, without an exit status).
        owner: name of the session file of the Blender that manages it.
        made, began, ended: times of its creation, start and end in seconds since the epoch.
        phase, step, of, eta, metrics, message: progress last reported by the engine; eta in seconds.
        preview: image of the state so far, or None.
        error: reason of a failure, in one line.
        stopping: True after a request to stop.
    """

    id: str
    kind: str
    title: str
    folder: Path
    notes: Path
    program: str = "engine"
    arguments: list[str] = field(default_factory=list)
    on_done: str | None = None
    data: dict[str, Any] = field(default_factory=dict)
    state: str = "queued"
    owner: str = ""
    made: float = 0.0
    began: float | None = None
    ended: float | None = None
    error: str | None = None
    phase: str = ""
    step: int = 0
    of: int = 0
    eta: float | None = None
    metrics: dict[str, float] = field(default_factory=dict)
    message: str = ""
    preview: Path | None = None
    stopping: bool = False
    _read: int = 0  # bytes of events.jsonl read so far

    @property
    def fraction(self) -> float:
        """Fraction of the current phase that is done, 0..1."""
        return min(self.step / self.of, 1.0) if self.of > 0 else 0.0

    @property
    def finished(self) -> bool:
        """True after the job has ended, however it ended."""
        return self.state not in UNFINISHED

    @property
    def resumable(self) -> bool:
        """True if `queue.resume` can continue the job."""
        return self.state in ("failed", "cancelled", "lost") and self.kind in ("reconstruct", "demo", "capture")

    @property
    def can_finish_early(self) -> bool:
        """True while the job runs a reconstruction, whose current phase can be ended early."""
        return self.state == "running" and self.kind in ("reconstruct", "demo") and not self.stopping

    @property
    def log(self) -> Path:
        """Path of the log file, which holds the job's stderr."""
        return self.notes / "log.txt"

    def log_tail(self, lines: int = LOG_LINES) -> list[str]:
        """Return the last lines of the log."""
        return _tail(self.log, 8192).splitlines()[-lines:]

    def output(self) -> str:
        """Return the text that the job wrote to stdout, its result."""
        try:
            return (self.notes / "output.txt").read_text("utf-8", errors="replace")
        except OSError:
            return ""

    def seconds(self) -> float | None:
        """Return the seconds that the job has been running, or ran until its end; None before its start."""
        return None if self.began is None else (self.ended or time.time()) - self.began

    # --- on disk

    def save(self) -> None:
        """Write job.json atomically."""
        values = {key: getattr(self, key) for key in STORED} | {"folder": str(self.folder)}
        partial = self.notes / "job.json.part"
        partial.write_text(json.dumps(values, indent=1), encoding="utf-8")
        replace(partial, self.notes / "job.json")

    def save_if_possible(self) -> None:
        """Write job.json, but only report in `message` if that fails, such as on a full disk."""
        try:
            self.save()
        except OSError as error:
            self.message = f"the job's state can't be saved: {error.strerror or error}"

    def request(self, name: str) -> None:
        """Write the request file `cancel` or `finish`, which the job's process looks for.

        Raises:
            IrgsppError: if it can't be written.
        """
        try:
            (self.notes / name).touch()
        except OSError as error:
            raise IrgsppError(f"{self.notes / name}: can't be written ({error.strerror})") from error

    def reload(self) -> None:
        """Read job.json again, which another Blender may have changed."""
        stored = load_job(self.notes)
        if stored is not None:
            for key in STORED:
                setattr(self, key, getattr(stored, key))

    def read_events(self) -> bool:
        """Read the progress reported since the last call, and return True if there was any."""
        self.stopping = self.stopping or (self.notes / "cancel").exists()
        before = self.preview
        self._look_for_preview()
        try:
            with (self.notes / "events.jsonl").open("rb") as file:
                size = file.seek(0, os.SEEK_END)
                if size <= self._read:
                    return self.preview is not before
                file.seek(max(self._read, size - TAIL_BYTES))
                data = file.read()
        except OSError:
            return self.preview is not before
        complete = data.rfind(b"\n") + 1  # the last line may not be complete yet
        self._read = size - len(data) + complete
        for line in data[:complete].splitlines():
            self._apply_event(line)
        return complete > 0

    def _apply_event(self, line: bytes) -> None:
        try:
            event = json.loads(line)
        except ValueError:  # a line without its beginning, or one cut off by a full disk
            return
        if not isinstance(event, dict):
            return
        if "phase" in event and event["phase"] != self.phase:
            self.phase, self.step, self.of, self.eta = str(event["phase"]), 0, 0, None
        if "step" in event:
            self.step, self.of, self.eta = int(event["step"]), int(event.get("of") or 0), event.get("eta")
        self.metrics |= {k: float(v) for k, v in event.items() if k in ("loss", "psnr", "gaussians") and v is not None}
        self.message = str(event.get("message", self.message))

    def _look_for_preview(self) -> None:
        image = self.folder / "previews" / "latest.png"
        try:
            if self.kind in ("reconstruct", "demo") and image.stat().st_mtime >= (self.began or 0.0):
                self.preview = image
        except OSError:
            self.preview = None


def new_job(root: Path, kind: str, title: str, folder: Path | None, **values: Any) -> Job:
    """Create a queued job and its private folder.

    Args:
        root: folder that holds the private folders of all jobs.
        kind: kind of the job.
        title: text in the list of jobs.
        folder: folder that the job reads or writes; None for its private folder alone.
        **values: further attributes of the job.
    """
    now = time.time()
    name = time.strftime("%Y%m%d-%H%M%S-", time.localtime(now)) + secrets.token_hex(3)
    notes = root / name
    notes.mkdir(parents=True, mode=0o700)  # private: logs name the user's files, and a file `cancel` in it stops the job
    return Job(name, kind, title, folder or notes, notes, made=now, **values)


def load_job(notes: Path) -> Job | None:
    """Load the job from its private folder; None if job.json is missing or damaged."""
    try:
        values = json.loads((notes / "job.json").read_text("utf-8"))
        return Job(folder=Path(values.pop("folder")), notes=notes, **{key: values[key] for key in STORED})
    except (OSError, ValueError, KeyError, TypeError, AttributeError):
        return None


def _tail(path: Path, size: int) -> str:
    try:
        with path.open("rb") as file:
            file.seek(max(0, file.seek(0, os.SEEK_END) - size))
            return file.read().decode("utf-8", errors="replace")
    except OSError:
        return ""
