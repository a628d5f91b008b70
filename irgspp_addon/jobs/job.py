# SPDX-License-Identifier: GPL-3.0-or-later
"""One job: what it is to do, where it stands, and the folder in which both outlive Blender."""

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
KEPT = ("id", "kind", "title", "program", "arguments", "on_done", "data", "state", "owner", "made", "began", "ended", "error", "message")
TAIL_BYTES = 65536  # of the events, from which the present state is read again after a restart
LOG_LINES = 12


@dataclass(eq=False)
class Job:
    """A job of the engine.

    Attributes:
        kind: "reconstruct", "demo", "render", "bake", "export", "inspect", "check" or "install".
        title: for the list of jobs.
        folder: what it works on or writes, such as the run folder.
        notes: its private folder: events.jsonl, log.txt, output.txt (what it printed), files `cancel` and `finish`, and job.json.
        program: "engine", or the path of a script that Blender's own Python runs.
        arguments: the words after `irgspp`, or those for the script.
        on_done: name in `jobs.ON_DONE` of what is called, in Blender, once it is done.
        data: what that function needs to know; JSON.
        state: "queued", "running", "done", "failed", "cancelled" or "lost" (it ended while nobody looked, without saying how).
        owner: name of the session file of the Blender that looks after it.
        phase, step, of, eta, figures, message: the last that the engine told; eta in seconds.
        preview: image of what is there so far, or None.
        error: one line that says why it failed.
        stopping: True once somebody asked it to stop.
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
    figures: dict[str, float] = field(default_factory=dict)
    message: str = ""
    preview: Path | None = None
    stopping: bool = False
    _read: int = 0  # bytes of events.jsonl

    @property
    def fraction(self) -> float:
        """Share of the present phase that is done, 0..1."""
        return min(self.step / self.of, 1.0) if self.of > 0 else 0.0

    @property
    def finished(self) -> bool:
        """True once nothing more will happen."""
        return self.state not in UNFINISHED

    @property
    def resumable(self) -> bool:
        """True where `jobs.resume` can go on with it."""
        return self.state in ("failed", "cancelled", "lost") and self.kind in ("reconstruct", "demo")

    @property
    def can_finish_early(self) -> bool:
        """True while it optimises something that may be left as it is."""
        return self.state == "running" and self.kind in ("reconstruct", "demo") and not self.stopping

    @property
    def log(self) -> Path:
        """The file with everything that it said on stderr."""
        return self.notes / "log.txt"

    def log_tail(self, lines: int = LOG_LINES) -> list[str]:
        """The last lines of the log."""
        return _tail(self.log, 8192).splitlines()[-lines:]

    def output(self) -> str:
        """What it printed as its result."""
        try:
            return (self.notes / "output.txt").read_text("utf-8", errors="replace")
        except OSError:
            return ""

    def seconds(self) -> float | None:
        """How long it has worked, or worked until its end."""
        return None if self.began is None else (self.ended or time.time()) - self.began

    # --- on disk

    def save(self) -> None:
        """Write job.json whole."""
        values = {key: getattr(self, key) for key in KEPT} | {"folder": str(self.folder)}
        partial = self.notes / "job.json.part"
        partial.write_text(json.dumps(values, indent=1), encoding="utf-8")
        replace(partial, self.notes / "job.json")

    def save_if_possible(self) -> None:
        """The same where a full disk must not stop what is going on; the message says so."""
        try:
            self.save()
        except OSError as error:
            self.message = f"this can't be noted down: {error.strerror or error}"

    def wish(self, name: str) -> None:
        """Leave the file `cancel` or `finish` for the process. Raises IrgsppError where that can't be written."""
        try:
            (self.notes / name).touch()
        except OSError as error:
            raise IrgsppError(f"{self.notes / name}: can't be written ({error.strerror})") from error

    def reload(self) -> None:
        """Take over what another Blender wrote in job.json since."""
        fresh = load_job(self.notes)
        if fresh is not None:
            for key in KEPT:
                setattr(self, key, getattr(fresh, key))

    def read_events(self) -> bool:
        """Take over what the engine told since the last call; True where that was anything."""
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
        whole = data.rfind(b"\n") + 1  # a line may just be being written
        self._read = size - len(data) + whole
        for line in data[:whole].splitlines():
            self._take(line)
        return whole > 0

    def _take(self, line: bytes) -> None:
        try:
            event = json.loads(line)
        except ValueError:  # the first line of a tail, or one cut off by a full disk
            return
        if not isinstance(event, dict):
            return
        if "phase" in event and event["phase"] != self.phase:
            self.phase, self.step, self.of, self.eta = str(event["phase"]), 0, 0, None
        if "step" in event:
            self.step, self.of, self.eta = int(event["step"]), int(event.get("of") or 0), event.get("eta")
        self.figures |= {k: float(v) for k, v in event.items() if k in ("loss", "psnr", "gaussians") and v is not None}
        self.message = str(event.get("message", self.message))

    def _look_for_preview(self) -> None:
        image = self.folder / "previews" / "latest.png"
        try:
            if self.kind in ("reconstruct", "demo") and image.stat().st_mtime >= (self.began or 0.0):
                self.preview = image
        except OSError:
            self.preview = None


def new_job(root: Path, kind: str, title: str, folder: Path | None, **values: Any) -> Job:
    """A queued job with a folder for its notes under `root`."""
    now = time.time()
    name = time.strftime("%Y%m%d-%H%M%S-", time.localtime(now)) + secrets.token_hex(3)
    notes = root / name
    notes.mkdir(parents=True, mode=0o700)  # logs name what its user works on, and `cancel` in it stops the job
    return Job(name, kind, title, folder or notes, notes, made=now, **values)


def load_job(notes: Path) -> Job | None:
    """The job whose notes are in that folder; None where job.json is missing or broken."""
    try:
        values = json.loads((notes / "job.json").read_text("utf-8"))
        return Job(folder=Path(values.pop("folder")), notes=notes, **{key: values[key] for key in KEPT})
    except (OSError, ValueError, KeyError, TypeError, AttributeError):
        return None


def _tail(path: Path, size: int) -> str:
    try:
        with path.open("rb") as file:
            file.seek(max(0, file.seek(0, os.SEEK_END) - size))
            return file.read().decode("utf-8", errors="replace")
    except OSError:
        return ""
