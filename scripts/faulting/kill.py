# SPDX-License-Identifier: GPL-3.0-or-later
"""Kills of the job at random moments: the next start must reach the same result as an undisturbed run."""

from __future__ import annotations

import random
import shutil
import tempfile
from collections import Counter
from collections.abc import Callable
from multiprocessing.process import BaseProcess
from pathlib import Path

from irgspp.core.run_folder import RunFolder, read_run
from irgspp.core.scene.reconstruction import Reconstruction
from stresses.case import Measured

from .cases import case_of
from .tiny import JobStarter, KillPoint, differing_files, kill_after, phase_of, phase_seconds, reference_run, settings, work

case = case_of("kill")


def check_kills(measured: Measured, moments: int, seed: int = 0) -> None:
    """Kill jobs and resume them; half of the moments are random times, half are just before an operation on the run's files.

    Args:
        measured: result of the case.
        moments: number of moments.
        seed: seed of the moments.
    """
    chance, starter = random.Random(seed), JobStarter()
    with tempfile.TemporaryDirectory(prefix="irgspp-faults-") as name:
        folder = Path(name)
        data, reference, operations = reference_run()
        lengths, phases = phase_seconds(reference), Counter()
        for i in range(moments):
            progress = (i // 2 + chance.random()) / ((moments + 1) // 2)  # spread over the whole job
            run = folder / "run"
            if i % 2:
                killed = starter.run(work, str(data), str(run), False, KillPoint(1 + int(0.9 * progress * operations))) == -9
            else:
                phase, seconds = lengths[int(progress * len(lengths))]
                process = starter.start(work, str(data), str(run), False, KillPoint())
                killed = kill_in(process, run, phase, chance.uniform(0, 0.8) * seconds)
            phases[phase_of(run) if killed else "too late"] += 1
            _resumed(measured, starter, data, run, reference, f"moment {i} ({phase_of(run)})")
            shutil.rmtree(run)
        measured.note(f"killed while at {', '.join(f'{phase} {n}' for phase, n in phases.items())}")
        measured.at_least("moments", moments - phases["too late"], 0.8 * moments)


def kill_in(process: BaseProcess, run: Path, phase: str, seconds: float) -> bool:
    """Kill a job some time after it has begun a phase.

    Args:
        process: process of the job.
        run: run folder.
        phase: name of the phase.
        seconds: seconds after the phase has begun.

    Returns:
        False where the job had ended before.
    """
    while process.exitcode is None and phase_of(run) != phase:
        process.join(0.005)
    return kill_after(process, seconds)


def _resumed(measured: Measured, starter: JobStarter, data: Path, run: Path, reference: Path, where: str) -> None:
    """Continue a killed run and check its result."""
    for what in unreadable(run):
        measured.holds(f"{where}: {what} is readable", False)
    resumable = (run / "run.json").is_file()
    status = starter.run(work, str(data), str(run), resumable, KillPoint())
    measured.holds(f"{where}: the next start ends well, not with status {status}", status == 0)
    if status == 0:
        measured.holds(f"{where}: run.json says done", read_run(run)["status"] == "done")
        different = differing_files(run, reference)
        measured.holds(f"{where}: the same bits, not others in {', '.join(different)}", not different)


def unreadable(run: Path) -> list[str]:
    """Return the files that a killed process left under their final names but that can't be read."""
    found = []
    if not (run / "run.json").is_file():
        return found
    folder = RunFolder.open(run, settings(), read_run(run)["dataset"], resume=True)
    try:
        for path in sorted((run / "checkpoint").glob("*.pt")):
            _try(found, path.name, lambda path=path: folder.load(path.stem))
        for place in (run, run / "checkpoint" / "first"):
            if (place / "reconstruction.json").is_file():
                _try(found, f"{place.name}/gaussians.ply", lambda place=place: Reconstruction.load(place))
    finally:
        folder.close()
    return found


def _try(found: list[str], name: str, read: Callable[[], object]) -> None:
    """Append a file to the list where it can't be read."""
    try:
        read()
    except Exception as error:
        found.append(f"{name} ({error})")


@case(
    "2 moments of a job of seconds",
    """SIGKILL at random moments of the clock and before random operations on files: what is on the disk can be read, and the next start
    ends with the same bits as an undisturbed run.""",
)
def some_moments(measured: Measured) -> None:
    """Check two moments."""
    check_kills(measured, 2)


@case("50 moments of a job of seconds", "The same at 50 moments, spread over all phases.", quick=False)
def many_moments(measured: Measured) -> None:
    """Check 50 moments."""
    check_kills(measured, 50, seed=1)


@case(
    "replacing another run",
    """A job that replaces another run is killed before each of its operations on the old run's files: the next start has nothing of the
    old run left, and the same bits as an undisturbed run.""",
    quick=False,
)
def replaced(measured: Measured) -> None:
    """Check the replacement of a run."""
    starter = JobStarter()
    with tempfile.TemporaryDirectory(prefix="irgspp-faults-") as name:
        folder = Path(name)
        data, reference, _ = reference_run()
        for operation in range(1, 12):
            run = shutil.copytree(reference, folder / "run")
            (run / "checkpoint").mkdir(exist_ok=True)
            (run / "checkpoint" / "first_stage.pt").write_bytes(b"another run's")
            status = starter.run(work, str(data), str(run), False, KillPoint(operation), True)
            measured.holds(f"operation {operation} is met", status == -9)
            _resumed_or_replaced(measured, starter, data, run, reference, operation)
            shutil.rmtree(run)


def _resumed_or_replaced(measured: Measured, starter: JobStarter, data: Path, run: Path, reference: Path, operation: int) -> None:
    """Start the job again and check its result."""
    done = read_run(run)["status"] == "done"  # killed before anything was changed
    status = starter.run(work, str(data), str(run), not done, KillPoint(), done)
    measured.holds(f"operation {operation}: the next start ends well, not with status {status}", status == 0)
    different = differing_files(run, reference)
    measured.holds(f"operation {operation}: the same bits, not others in {', '.join(different)}", not different)
