# SPDX-License-Identifier: GPL-3.0-or-later
"""Reconstructions that the benchmark's sections share, each made once by `irgspp reconstruct` in a process of its own."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from irgspp.core.errors import IrgsppError
from irgspp.core.pipeline import FIRST_STAGE
from irgspp.core.run_folder import read_run, write_atomic

POLL = 0.2  # seconds between looks at a running reconstruction


@dataclass(frozen=True)
class RunPlan:
    """How a scene is reconstructed.

    Attributes:
        label: unique among a scene's runs; with the scene's name it is the folder's.
        preset: to start from. options: `--set` each. materials: "" leaves the choice to the job.
        time: as after `--time`; "" for as long as it takes.
        seconds: expected on two cores.
    """

    label: str
    preset: str = "balanced"
    options: tuple[str, ...] = ()
    materials: str = ""
    time: str = ""
    seconds: float = 120.0

    def words(self) -> list[str]:
        """Options of `irgspp reconstruct`."""
        words = ["--preset", self.preset]
        words += ["--materials", self.materials] if self.materials else []
        words += ["--time", self.time] if self.time else []
        return words + [word for option in self.options for word in ("--set", option)]


@dataclass(frozen=True)
class Run:
    """A finished reconstruction.

    Attributes:
        path: the run folder. first: what the first stage alone found, as far as `Reconstruction.load` reads it.
        seconds: wall clock of its phases together. process_seconds: of the process, its start included. cpu_seconds: of all threads.
    """

    path: Path
    first: Path
    seconds: float
    process_seconds: float
    cpu_seconds: float

    @property
    def about(self) -> dict[str, Any]:
        """run.json."""
        return read_run(self.path)

    @property
    def peak_memory(self) -> int:
        """Bytes, of the hungriest phase."""
        return max(phase["peak_memory"] for phase in self.about["phases"].values())

    def phase_seconds(self) -> dict[str, float]:
        """Wall clock of each phase."""
        return {name: phase["seconds"] for name, phase in self.about["phases"].items()}


def finished(plan: RunPlan, dataset: Path, path: Path) -> Run | None:
    """The run in the folder, where it is one of this plan and done; else None."""
    note = _note(path)
    try:
        about = json.loads(note.read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return None
    if about.get("plan") != _plan(plan, dataset) or not about.get("done"):
        return None
    seconds = sum(phase["seconds"] for phase in read_run(path)["phases"].values())
    return Run(path, _first(path), seconds, about["process_seconds"], about["cpu_seconds"])


def make(plan: RunPlan, dataset: Path, path: Path, ticked: Callable[[], None]) -> Run:
    """Reconstruct, or go on with what an interrupted benchmark left; `ticked` is called every now and then.

    Raises IrgsppError with the job's last line where it fails.
    """
    before = _interrupted(plan, dataset, path)
    command = [sys.executable, "-P", "-m", "irgspp", "reconstruct", str(dataset), "-o", str(path), *plan.words()]
    command += ["--resume"] if before else ["--overwrite"]
    about = before or {"plan": _plan(plan, dataset), "done": False, "process_seconds": 0.0, "cpu_seconds": 0.0}
    path.parent.mkdir(parents=True, exist_ok=True)
    if not before:
        shutil.rmtree(_first(path), ignore_errors=True)
    write_atomic(_note(path), json.dumps(about).encode())
    began, cpu = time.monotonic(), _children_seconds()
    try:
        status, said = _watch(command, path, ticked)
    finally:
        about["process_seconds"] += time.monotonic() - began
        about["cpu_seconds"] += _children_seconds() - cpu
        write_atomic(_note(path), json.dumps(about).encode())
    if status:
        raise IrgsppError(f"irgspp reconstruct ended with status {status}: {said}")
    write_atomic(_note(path), json.dumps({**about, "done": True}).encode())
    run = finished(plan, dataset, path)
    assert run is not None
    return run


def _watch(command: list[str], path: Path, ticked: Callable[[], None]) -> tuple[int, str]:
    """Run to the end, keeping the first stage's result while it is there; the exit status, and the last line on stderr."""
    first = _first(path)
    with path.with_name(path.name + ".log").open("w+", encoding="utf-8", errors="replace") as log:
        child = subprocess.Popen(command, stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL, stderr=log)
        try:
            while (status := child.poll()) is None:
                _keep_first(path, first)
                ticked()
                time.sleep(POLL)
        except BaseException:  # Ctrl-C: the job saves what it has, whether the terminal told it as well or not
            if path.is_dir():
                (path / "cancel").touch()
            child.wait()
            raise
        log.seek(0)
        lines = [line.strip() for line in log if line.strip()]
    return status, lines[-1] if lines else "no message"


def _keep_first(path: Path, first: Path) -> None:
    """Copy the first stage's result as soon as it is complete: the job removes it in the end."""
    source = path / FIRST_STAGE
    if first.is_dir() or not (source / "reconstruction.json").is_file():
        return
    try:
        phases = read_run(path)["phases"]
    except (IrgsppError, KeyError):
        return  # not written yet
    if phases.get("first stage", {}).get("finished"):
        partial = first.with_name(first.name + ".part")
        shutil.rmtree(partial, ignore_errors=True)
        shutil.copytree(source, partial)
        partial.rename(first)


def _interrupted(plan: RunPlan, dataset: Path, path: Path) -> dict[str, Any] | None:
    """The note of a run of this plan that can be resumed."""
    try:
        about = json.loads(_note(path).read_text(encoding="utf-8"))
        status = json.loads((path / "run.json").read_text(encoding="utf-8"))["status"]
    except (OSError, ValueError, KeyError):
        return None
    return about if about.get("plan") == _plan(plan, dataset) and status in ("running", "cancelled") else None


def _plan(plan: RunPlan, dataset: Path) -> list[str]:
    return [str(dataset.resolve()), *plan.words()]


def _first(path: Path) -> Path:
    return path.with_name(path.name + "-first")


def _note(path: Path) -> Path:
    return path.with_name(path.name + ".json")


def _children_seconds() -> float:
    """CPU seconds of the processes that were waited for; 0 on Windows, which does not tell."""
    times = os.times()
    return times.children_user + times.children_system
