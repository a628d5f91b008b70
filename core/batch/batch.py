# SPDX-License-Identifier: GPL-3.0-or-later
"""A list of jobs worked off: what is done is left alone, what was stopped goes on, what fails is noted and passed over."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

from ..errors import Cancelled, InputError
from ..io.file_lock import FileLock
from .job_runner import CANCEL
from .job_state import JobFolder, Progress, State, is_there
from .jobs import Job
from .table import BatchTable
from .workers import Ticket, pool_for

LOOK_SECONDS = 0.2
LOCK = ".lock"


def notes_of(path: Path) -> Path:
    """The folder of a batch's notes: beside its list, so that whoever sees the list sees them."""
    return path.resolve().with_suffix(".batch")


def run_batch(
    jobs: Sequence[Job],
    notes: Path,
    cancelled: Callable[[], bool],
    at_once: int = 1,
    dask: str | None = None,
) -> dict[str, State]:
    """Work all jobs off, on this machine or on a dask cluster, and return how each ended.

    Raises InputError where another process works on the same list, or no cluster is there; Cancelled once `cancelled` said so and every
    job that ran has saved what it had.
    """
    lock = _claim(notes)
    try:
        (notes / CANCEL).unlink(missing_ok=True)
        states = {job.name: _before(job, JobFolder(notes / job.name)) for job in jobs}
        missing = [job for job in jobs if states[job.name].state == "waiting"]
        for job in missing:
            _noted_waiting(JobFolder(notes / job.name), states[job.name])
        with pool_for(notes, at_once, dask) as pool:
            tickets = {job.name: pool.submit(job) for job in missing}
            _watch(tickets, states, notes, cancelled)
    finally:
        lock.release()
    if any(state.state == "cancelled" for state in states.values()) or cancelled():
        done = sum(state.state == "done" for state in states.values())
        raise Cancelled(f"{done} of {len(jobs)} jobs are done, the others go on with the same command")
    return states


def _claim(notes: Path) -> FileLock:
    try:
        notes.mkdir(parents=True, exist_ok=True)
        return FileLock(notes / LOCK)
    except BlockingIOError:
        raise InputError(notes, "another process works on this list", "wait for it") from None
    except OSError as error:
        raise InputError(notes, f"can't be written ({error.strerror})") from error


def _before(job: Job, folder: JobFolder) -> State:
    """A job is done where all of its steps are; otherwise it waits, whatever became of it the last time."""
    state = folder.read()
    done = all(is_there(job, step, state) for step in job.steps)
    return replace(state, state="done" if done else "waiting", error="")


def _noted_waiting(folder: JobFolder, state: State) -> None:
    """What a killed batch left says that it runs."""
    folder.prepare()
    folder.write(state)


def _watch(tickets: dict[str, Ticket], states: dict[str, State], notes: Path, cancelled: Callable[[], bool]) -> None:
    """Until all have ended; a wish to stop is passed on through a file, which the machines of a cluster see too."""
    asked, left, board = False, dict(tickets), BatchTable()
    while left:
        if cancelled() and not asked:
            asked = True
            (notes / CANCEL).touch()
            for ticket in left.values():
                ticket.withdraw()
        for name, ticket in list(left.items()):
            if ticket.done():
                states[name] = ticket.result()
                del left[name]
            elif (noted := JobFolder(notes / name).read()).state == "running":
                states[name] = noted
        board.show(_rows(states, notes))
        time.sleep(LOOK_SECONDS)
    board.show(_rows(states, notes), last=True)


def _rows(states: dict[str, State], notes: Path) -> list[tuple[str, State, Progress]]:
    return [(name, state, JobFolder(notes / name).progress() if state.state == "running" else Progress()) for name, state in states.items()]
