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
    """Plan of a reconstruction.

    Attributes:
        label: unique among a scene's runs; with the scene's name it is the folder's name.
        preset: preset to start from.
        options: settings as `KEY=VALUE`, each after `--set`.
        materials: as after `--materials`; "" leaves the choice to the job.
        time: as after `--time`; "" for none.
        seconds: expected seconds on two cores.
    """

    label: str
    preset: str = "balanced"
    options: tuple[str, ...] = ()
    materials: str = ""
    time: str = ""
    seconds: float = 120.0

    def words(self) -> list[str]:
        """Return the options of `irgspp reconstruct`."""
        words = ["--preset", self.preset]
        words += ["--materials", self.materials] if self.materials else []
        words += ["--time", self.time] if self.time else []
        return words + [word for option in self.options for word in ("--set", option)]


@dataclass(frozen=True)
class Run:
    """Finished reconstruction.

    Attributes:
        path: run folder.
        first: folder with the result of the first stage alone, as far as `Reconstruction.load` reads it.
        seconds: wall clock of all phases together.
        process_seconds: wall clock of the process, its start included.
        cpu_seconds: CPU time of all threads.
    """

    path: Path
    first: Path
    seconds: float
    process_seconds: float
    cpu_seconds: float

    @property
    def about(self) -> dict[str, Any]:
        """Content of run.json."""
        return read_run(self.path)

    @property
    def peak_memory(self) -> int:
        """Peak memory of the phase with the most, in bytes."""
        return max(phase["peak_memory"] for phase in self.about["phases"].values())

    def phase_seconds(self) -> dict[str, float]:
        """Return the wall clock of each phase."""
        return {name: phase["seconds"] for name, phase in self.about["phases"].items()}


def finished(plan: RunPlan, dataset: Path, path: Path) -> Run | None:
    """Return the finished run in a folder.

    Args:
        plan: plan of the reconstruction.
        dataset: folder of the dataset.
        path: run folder.

    Returns:
        The run; None where the folder holds none of this plan, or an unfinished one.
    """
    note = _note(path)
    try:
        about = json.loads(note.read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return None
    if about.get("plan") != _plan(plan, dataset) or not about.get("done"):
        return None
    seconds = sum(phase["seconds"] for phase in read_run(path)["phases"].values())
    return Run(path, _first(path), seconds, about["process_seconds"], about["cpu_seconds"])


def make(plan: RunPlan, dataset: Path, path: Path, on_tick: Callable[[], None]) -> Run:
    """Reconstruct a dataset, or continue a reconstruction that an earlier benchmark left unfinished.

    Args:
        plan: plan of the reconstruction.
        dataset: folder of the dataset.
        path: run folder.
        on_tick: called now and then.

    Raises:
        IrgsppError: with the job's last line, where the job fails.
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
        status, last_line = _watch(command, path, on_tick)
    finally:
        about["process_seconds"] += time.monotonic() - began
        about["cpu_seconds"] += _children_seconds() - cpu
        write_atomic(_note(path), json.dumps(about).encode())
    if status:
        raise IrgsppError(f"irgspp reconstruct ended with status {status}: {last_line}")
    write_atomic(_note(path), json.dumps({**about, "done": True}).encode())
    run = finished(plan, dataset, path)
    assert run is not None
    return run


def _watch(command: list[str], path: Path, on_tick: Callable[[], None]) -> tuple[int, str]:
    """Run a command to its end and copy the first stage's result while it exists; return the exit status and the last line on stderr."""
    first = _first(path)
    with path.with_name(path.name + ".log").open("w+", encoding="utf-8", errors="replace") as log:
        child = subprocess.Popen(command, stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL, stderr=log)
        try:
            while (status := child.poll()) is None:
                _copy_first(path, first)
                on_tick()
                time.sleep(POLL)
        except BaseException:  # Ctrl-C: the job saves its state, whether the terminal signalled it as well or not
            if path.is_dir():
                (path / "cancel").touch()
            child.wait()
            raise
        log.seek(0)
        lines = [line.strip() for line in log if line.strip()]
    return status, lines[-1] if lines else "no message"


def _copy_first(path: Path, first: Path) -> None:
    """Copy the first stage's result as soon as it is complete, because the job removes it in the end."""
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
    """Return the note of a run of this plan that can be resumed; None where there is none."""
    try:
        about = json.loads(_note(path).read_text(encoding="utf-8"))
        status = json.loads((path / "run.json").read_text(encoding="utf-8"))["status"]
    except (OSError, ValueError, KeyError):
        return None
    return about if about.get("plan") == _plan(plan, dataset) and status in ("running", "cancelled") else None


def _plan(plan: RunPlan, dataset: Path) -> list[str]:
    """Return the dataset and options that identify a plan."""
    return [str(dataset.resolve()), *plan.words()]


def _first(path: Path) -> Path:
    """Return the folder for the first stage's result."""
    return path.with_name(path.name + "-first")


def _note(path: Path) -> Path:
    """Return the file that says which plan a run is of, and whether it is finished."""
    return path.with_name(path.name + ".json")


def _children_seconds() -> float:
    """Return the CPU seconds of all child processes that have ended; 0 on Windows, which does not count them."""
    times = os.times()
    return times.children_user + times.children_system
