# SPDX-License-Identifier: GPL-3.0-or-later
"""The folder of one job: run.json, events.jsonl, log.txt, checkpoints and results; nothing in it is ever half-written."""

from __future__ import annotations

import json
import os
import shutil
import time
import traceback
import zipfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

import numpy as np

from .errors import Cancelled, InputError
from .io.atomic import atomic_file, write_atomic
from .io.file_lock import FileLock
from .machine.out_of_resources import translate_errors
from .machine.peak_memory import peak_memory, reset_peak_memory
from .progress.event_log import EventLog
from .settings.overrides import differences, from_dict, to_dict
from .settings.schema import Settings

RESULTS = ("gaussians.ply", "environment.exr", "reflections.npz", "background.exr", "reconstruction.json")
RESULTS += ("mesh.ply", "asset.glb", "scene.blend", "cameras.json", "contact_sheet.png")
FOLDERS = ("checkpoint", "textures", "evaluation", "photographs", "previews")
NOTES = ("events.jsonl", "log.txt", "cancel", "finish")
LOCK = ".lock"
PHASES_BEFORE = {"reflective": "first stage", "transport": "second stage"}  # names of phases in version 0.1 -> now
CHECKPOINT_BEFORE, CHECKPOINT = "reflective.pt", "first_stage.pt"  # of the first stage, in version 0.1 and now
BEGUN = (LOCK, ".run.part.json")  # all there is of a run that was killed right at its beginning


def read_run(path: Path) -> dict[str, Any]:
    """run.json of a run folder. Raises InputError where there is none or it is broken."""
    file = path / "run.json"
    if not file.is_file():
        raise InputError(path, "is not a run folder (no run.json in it)")
    try:
        state = json.loads(file.read_text("utf-8"))
        phases = {PHASES_BEFORE.get(name, name): _phase(phase) for name, phase in state["phases"].items()}
        state |= {"phases": phases, "settings": dict(state["settings"])}
        json.dumps(state, allow_nan=False)  # what can't be written again is no state
        return state
    except (OSError, ValueError, KeyError, TypeError, AttributeError, OverflowError, RecursionError) as error:
        raise InputError(file, f"is broken ({error})", "start the run anew with --overwrite") from error


def _phase(entry: dict[str, Any]) -> dict[str, Any]:
    return {"seconds": float(entry["seconds"]), "peak_memory": int(entry["peak_memory"]), "finished": bool(entry["finished"])}


def check_claim(path: Path, resume: bool, overwrite: bool) -> None:
    """Raise InputError where a run can't be made in `path`: a file, not writable, in use, or holding something else."""
    parent = next(p for p in (path, *path.absolute().parents) if p.exists())
    if not parent.is_dir():
        raise InputError(path, f"can't be made, {parent} is a file" if parent != path else "is a file, not a folder")
    if not os.access(parent, os.W_OK | os.X_OK):
        raise InputError(path, "is not writable")
    if not path.exists() or not any(p.name not in BEGUN for p in path.iterdir()):
        return
    if not (path / "run.json").is_file():
        raise InputError(path, "is not empty and not a run folder", "name another folder")
    if not resume and not overwrite:
        raise InputError(path, "holds another run", "go on with it by --resume, replace it by --overwrite, or name another folder")


class RunFolder(EventLog):
    """One run on disk; also the `Checkpoint` of its stages. Open it by `RunFolder.open`, which holds a lock until `close`.

    `state` is what run.json holds: status ("running", "done", "failed", "cancelled"), error, replaces (True while files of the run
    before are being removed), versions, dataset, settings, seed, computed_on {device, why}, phases {name: {seconds, peak_memory,
    finished}}, skipped [{what, why}], rules {name: {on, evidence}}, pace {stage: times the settings' schedules that its own were},
    training {figure: value}.
    """

    def __init__(self, path: Path, state: dict[str, Any], lock: FileLock) -> None:
        super().__init__(path)
        self.state, self._lock = state, lock

    @classmethod
    def open(cls, path: Path, settings: Settings, dataset: str, *, resume: bool = False, overwrite: bool = False) -> RunFolder:
        """Make the folder, or go on with the run in it (`resume`), or replace that run (`overwrite`, after which nothing of it is left).

        Raises InputError where that is not possible, and where the run to go on with had other settings or another dataset.
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
            return cls(path, _state(path, settings, dataset, resume, overwrite), lock)._started()
        except BaseException:
            lock.release()
            raise

    def _started(self) -> RunFolder:
        self.state.update(status="running", error=None)
        self.write()  # before anything else: only with it the folder is a run's
        if self.state.get("replaces"):
            clear(self.path)
            del self.state["replaces"]
            self.write()
        for name in ("cancel", "finish"):
            (self.path / name).unlink(missing_ok=True)
        (self.path / "checkpoint").mkdir(exist_ok=True)
        return self

    def close(self) -> None:
        """Give the folder free for other processes."""
        self._lock.release()

    def write(self) -> None:
        """Bring run.json up to date."""
        write_atomic(self.path / "run.json", (json.dumps(self.state, indent=2, allow_nan=False) + "\n").encode())

    # --- what happened

    def skip(self, what: str, why: str) -> None:
        """Note that a part of the job was left out."""
        self.state["skipped"] = [s for s in self.state["skipped"] if s["what"] != what] + [{"what": what, "why": why}]
        self.write()
        self.log(f"skipped {what}: {why}")

    def rule(self, name: str, on: bool, evidence: str) -> None:
        """Note whether a rule that leaves work out is in force, in run.json as well."""
        super().rule(name, on, evidence)
        self.state.setdefault("rules", {})[name] = {"on": on, "evidence": evidence}
        self.write()

    # --- phases

    def finished(self, phase: str) -> bool:
        """True where an earlier start of this run has done the phase."""
        return bool(self.state["phases"].get(phase, {}).get("finished"))

    def seconds(self, phase: str) -> float:
        """What a phase has taken so far; 0 before it has begun."""
        return float(self.state["phases"].get(phase, {}).get("seconds", 0.0))

    @property
    def spent(self) -> float:
        """Seconds that all phases have taken so far, in earlier starts too."""
        return sum(self.seconds(phase) for phase in self.state["phases"])

    def record(self, phase: str, seconds: float, peak: int, finished: bool) -> None:
        """Put a phase into run.json; the seconds of interrupted starts add up."""
        before = self.state["phases"].get(phase, {"seconds": 0.0, "peak_memory": 0})
        self.state["phases"][phase] = {
            "seconds": round(before["seconds"] + seconds, 3),
            "peak_memory": max(before["peak_memory"], peak),
            "finished": finished,
        }
        self.write()

    @contextmanager
    def timed(self, phase: str) -> Iterator[None]:
        """Measure a phase: seconds and peak memory (bytes, of this process); finished only where the block ends well."""
        reset_peak_memory()
        began, finished = time.monotonic(), False
        try:
            yield
            finished = True
        finally:
            self.record(phase, time.monotonic() - began, peak_memory(), finished)

    @contextmanager
    def job(self) -> Iterator[None]:
        """Run the block as this folder's job: its end becomes the status, an error is logged with its traceback."""
        try:
            with translate_errors(self.path):
                yield
        except BaseException as error:
            with suppress(OSError):  # a full disk, which the error itself tells; run.json is then as after a kill
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

    # --- Checkpoint

    def save(self, name: str, state: dict[str, Any]) -> None:
        """Keep the state of a stage: nested dicts, lists and tuples of tensors, arrays (come back as tensors), numbers and strings."""
        import torch

        folder = self.path / "checkpoint"
        folder.mkdir(exist_ok=True)
        # Given a path, torch doesn't say why it could not be written.
        with atomic_file(folder / f"{name}.pt") as partial, partial.open("wb") as file:
            torch.save(_as_tensors(state), file)

    def load(self, name: str, restored: Callable[[dict[str, Any]], Any] = dict) -> Any:
        """What `restored` makes of what `save` kept under a name, on the CPU; None without. Raises InputError where the file is damaged."""
        import torch

        path = self.path / "checkpoint" / f"{name}.pt"
        if not path.exists():
            return None
        try:
            with zipfile.ZipFile(path) as archive:
                if sum(entry.file_size for entry in archive.infolist()) > path.stat().st_size:
                    raise ValueError("its parts claim to be larger than it is")  # torch compresses nothing
                if archive.testzip() is not None:  # torch reads on where the disk has lost a bit
                    raise ValueError("a checksum differs")
            return restored(torch.load(path, map_location="cpu", weights_only=True))
        except MemoryError:
            raise
        except Exception as error:  # a damaged file raises nearly anything
            raise InputError(path, "the checkpoint can't be read", "delete it, or start anew with --overwrite") from error


def _state(path: Path, settings: Settings, dataset: str, resume: bool, overwrite: bool) -> dict[str, Any]:
    """The state to start with: that of the run to go on with, or a new one."""
    there = (path / "run.json").is_file()
    if there and resume:
        return _resumed(path, settings, dataset)
    return {
        "status": "running",
        **({"replaces": True} if there else {}),
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
    other = differences(from_dict(state["settings"], path / "run.json"), settings)
    if state.get("dataset") != dataset:
        other.append(f"dataset: {state.get('dataset')} -> {dataset}")
    if other:
        raise InputError(path, f"was started otherwise ({'; '.join(other)})", "give --resume the same options or none")
    before = path / "checkpoint" / CHECKPOINT_BEFORE
    if before.is_file():
        before.replace(before.with_name(CHECKPOINT))
    return state


def clear(path: Path) -> None:
    """Remove a run's own files from its folder and nothing else; run.json, without which the folder would be no run's, stays."""
    for name in FOLDERS:
        shutil.rmtree(path / name, ignore_errors=True)
    for name in (*RESULTS, *NOTES):
        (path / name).unlink(missing_ok=True)


def versions() -> dict[str, str]:
    """Versions of what the result depends on; packages that are not installed are left out."""
    import platform
    from importlib import metadata

    found = {"python": platform.python_version(), "platform": platform.platform()}
    for name in ("irgspp", "torch", "numba", "numpy", "scipy", "scikit-image", "xatlas", "embreex", "bpy", "warp-lang"):
        try:
            found[name] = metadata.version(name)
        except metadata.PackageNotFoundError:
            continue
    return found


def _as_tensors(value: Any) -> Any:
    import torch

    if isinstance(value, dict):
        return {k: _as_tensors(v) for k, v in value.items()}
    if isinstance(value, list | tuple):
        return type(value)(_as_tensors(v) for v in value)
    if isinstance(value, np.ndarray):
        return torch.from_numpy(np.ascontiguousarray(value))
    return value.item() if isinstance(value, np.generic) else value
