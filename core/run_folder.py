# SPDX-License-Identifier: GPL-3.0-or-later
"""Run folder of one job: run.json, events.jsonl, log.txt, checkpoints and results, every file written atomically."""

from __future__ import annotations

import json
import shutil
import time
import traceback
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

from .errors import Cancelled, InputError, IrgsppError
from .io.atomic import write_atomic
from .io.checkpoint import load_checkpoint, save_checkpoint
from .io.file_lock import FileLock
from .io.run_files import CAPTURE, CHECKPOINT, LOCK, OLD_CHECKPOINT, check_claim, clear
from .io.run_json import read_run
from .machine.out_of_resources import translate_errors
from .machine.peak_memory import peak_memory, reset_peak_memory
from .machine.versions import versions
from .progress.event_log import EventLog
from .progress.protocol import Progress
from .settings.overrides import differences, from_dict, to_dict
from .settings.schema import Settings

SPHERE = ("capture.centre", "capture.radius")  # settings that may change when a run is resumed: the object is then cut out again


class RunFolder(EventLog):
    """Run folder on disk; also the `Checkpoint` of its stages. Open it with `RunFolder.open`, which holds a lock until `close`.

    Attributes:
        state: content of run.json: status ("running", "done", "failed", "cancelled"), error, replaces (True while files of the
            previous run are being removed), recut (the same while its capture is kept), versions, dataset, settings, seed,
            computed_on {device, why}, phases {name: {seconds, peak_memory, finished}}, skipped [{what, why}], rules {name: {on,
            evidence}}, pace {stage: schedule scale, as a multiple of the settings' schedule}, training {metric: value}, textures
            {tiles, size, baked, texel, why}.
    """

    def __init__(self, path: Path, state: dict[str, Any], lock: FileLock) -> None:
        super().__init__(path)
        self.state, self._lock = state, lock

    @classmethod
    def open(
        cls,
        path: Path,
        settings: Settings,
        dataset: str,
        *,
        resume: bool = False,
        overwrite: bool = False,
        recut: Callable[[], object] | None = None,
    ) -> RunFolder:
        """Make a run folder, or open one to resume or replace its run.

        A run that is resumed with another sphere about the object (SPHERE) begins anew with its capture.

        Args:
            path: run folder.
            settings: of the run; those of the run in the folder where it is resumed.
            dataset: path of the dataset as run.json records it.
            resume: continue the run in the folder.
            overwrite: replace the run in the folder; none of its files is left afterwards.
            recut: cuts the object out again where the sphere is another one; if it raises, the run stays as it was.

        Raises:
            InputError: `check_claim` refuses the folder, another process uses it, or its run had other settings or another dataset.
        """
        check_claim(path, resume, overwrite)
        try:
            path.mkdir(parents=True, exist_ok=True)
            lock = FileLock(path / LOCK)
        except BlockingIOError as error:
            raise InputError(path, "is in use by another process") from error
        except OSError as error:
            raise InputError(path, f"is not writable ({error.strerror})") from error
        try:
            state = _state(path, settings, dataset, resume, overwrite)
            if state.get("recut") and recut is not None:
                recut()
            return cls(path, state, lock)._started()
        except BaseException:
            lock.release()
            raise

    def _started(self) -> RunFolder:
        self.state.update(status="running", error=None)
        self.write()  # before anything else: only with run.json the folder counts as a run folder
        for name, kept in (("replaces", ()), ("recut", (CAPTURE,))):
            if self.state.get(name):
                clear(self.path, kept)
                del self.state[name]
                self.write()
        for name in ("cancel", "finish"):
            (self.path / name).unlink(missing_ok=True)
        (self.path / "checkpoint").mkdir(exist_ok=True)
        return self

    def close(self) -> None:
        """Release the lock, so that other processes may use the folder."""
        self._lock.release()

    def write(self) -> None:
        """Write `state` to run.json."""
        write_atomic(self.path / "run.json", (json.dumps(self.state, indent=2, allow_nan=False) + "\n").encode())

    def skip(self, what: str, why: str) -> None:
        """Record in run.json and log.txt that a part of the job was skipped.

        Args:
            what: the skipped part, such as a file's name.
            why: the reason, in one line.
        """
        self.state["skipped"] = [s for s in self.state["skipped"] if s["what"] != what] + [{"what": what, "why": why}]
        self.write()
        self.log(f"skipped {what}: {why}")

    def rule(self, name: str, on: bool, evidence: str) -> None:
        """Record the decision on a skip rule in log.txt and run.json.

        Args:
            name: of the setting, without "skip.".
            on: True where the rule is in force.
            evidence: reason, in one line.
        """
        super().rule(name, on, evidence)
        self.state.setdefault("rules", {})[name] = {"on": on, "evidence": evidence}
        self.write()

    def finished(self, phase: str) -> bool:
        """Return True where an earlier start of this run has finished the phase."""
        return bool(self.state["phases"].get(phase, {}).get("finished"))

    def seconds(self, phase: str) -> float:
        """Return the seconds that a phase has taken so far, in all starts; 0 before it has begun."""
        return float(self.state["phases"].get(phase, {}).get("seconds", 0.0))

    @property
    def spent(self) -> float:
        """Seconds that all phases have taken so far, in all starts."""
        return sum(self.seconds(phase) for phase in self.state["phases"])

    def record(self, phase: str, seconds: float, peak: int, finished: bool) -> None:
        """Record a phase in run.json; the seconds of interrupted starts add up.

        Args:
            phase: its name.
            seconds: that it took in this start.
            peak: largest memory in use in this start, bytes.
            finished: True where it is complete.
        """
        before = self.state["phases"].get(phase, {"seconds": 0.0, "peak_memory": 0})
        self.state["phases"][phase] = {
            "seconds": round(before["seconds"] + seconds, 3),
            "peak_memory": max(before["peak_memory"], peak),
            "finished": finished,
        }
        self.write()

    @contextmanager
    def timed(self, phase: str) -> Iterator[None]:
        """Measure the block as a phase: seconds and peak memory (bytes, of this process); finished unless the block raises."""
        reset_peak_memory()
        began, finished = time.monotonic(), False
        try:
            yield
            finished = True
        finally:
            self.record(phase, time.monotonic() - began, peak_memory(), finished)

    def run_phase(self, name: str, work: Callable[[], None], progress: Progress) -> None:
        """Run and measure a phase unless an earlier start has finished it; raise Cancelled where the user stopped the job.

        Args:
            name: of the phase in run.json.
            work: does the phase.
            progress: its `cancelled` is read before and, where `work` fails, afterwards.
        """
        if self.finished(name):
            progress.message(f"{name}: finished before")
            return
        if progress.cancelled:
            raise Cancelled(f"stopped before the phase {name}")
        try:
            with self.timed(name):
                work()
        except IrgsppError as error:
            if progress.cancelled and not isinstance(error, Cancelled):  # Ctrl-C also ends child processes
                raise Cancelled(f"stopped in the phase {name}") from error
            raise

    @contextmanager
    def job(self) -> Iterator[None]:
        """Run the block as this folder's job: record its outcome as the status, log an error with its traceback."""
        try:
            with translate_errors(self.path):
                yield
        except BaseException as error:
            with suppress(OSError):  # a full disk, which the error itself reports; run.json is then as after a kill
                self._ended(error)
            raise
        self.state.update(status="done", error=None)
        shutil.rmtree(self.path / "checkpoint", ignore_errors=True)
        self.write()

    def _ended(self, error: BaseException) -> None:
        stopped = isinstance(error, Cancelled | KeyboardInterrupt)
        self.state.update(status="cancelled" if stopped else "failed", error=None if stopped else f"{type(error).__name__}: {error}")
        self.write()
        self.log("cancelled" if stopped else "".join(traceback.format_exception(error)).rstrip())

    def save(self, name: str, state: dict[str, Any]) -> None:
        """Write the state of a stage, atomically.

        Args:
            name: of the file in checkpoint/, without suffix.
            state: see `save_checkpoint`.
        """
        save_checkpoint(self.path / "checkpoint" / f"{name}.pt", state)

    def load(self, name: str, restored: Callable[[dict[str, Any]], Any] = dict) -> Any:
        """Return `restored(state)` of a checkpoint, its tensors on the CPU; None where there is none.

        Args:
            name: of the file in checkpoint/, without suffix.
            restored: see `load_checkpoint`.
        """
        return load_checkpoint(self.path / "checkpoint" / f"{name}.pt", restored)


def _state(path: Path, settings: Settings, dataset: str, resume: bool, overwrite: bool) -> dict[str, Any]:
    """Return the state to start with: that of the run to resume, or a new one."""
    exists = (path / "run.json").is_file()
    if exists and resume:
        return _resumed(path, settings, dataset)
    return {**_new(settings, dataset), **({"replaces": True} if exists else {})}


def _new(settings: Settings, dataset: str) -> dict[str, Any]:
    """Return the state of a run that has not begun."""
    return {
        "status": "running",
        "error": None,
        "versions": versions(),
        "dataset": dataset,
        "settings": to_dict(settings),
        "seed": settings.seed,
        "phases": {},
        "pace": {},
        "skipped": [],
        "training": {},
    }


def _resumed(path: Path, settings: Settings, dataset: str) -> dict[str, Any]:
    state = read_run(path)
    changed = differences(from_dict(state["settings"], path / "run.json"), settings)
    other = [line for line in changed if line.partition(":")[0] not in SPHERE]
    before = str(state.get("dataset"))
    if before != dataset and (Path(before).exists() or Path(before).name != Path(dataset).name):
        other.append(f"dataset: {before} -> {dataset}")
    if other:
        raise InputError(path, f"was started with other options ({'; '.join(other)})", "give --resume the same options or none")
    if changed:
        return {**_new(settings, dataset), "recut": True}
    state["dataset"] = dataset  # a project that was moved as a whole has it at another place
    old = path / "checkpoint" / OLD_CHECKPOINT
    if old.is_file():
        old.replace(old.with_name(CHECKPOINT))
    return state
