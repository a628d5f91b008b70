# SPDX-License-Identifier: GPL-3.0-or-later
"""Batch run of a job list: completed jobs are skipped, interrupted ones resumed, failures recorded without stopping the others."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

from ..errors import Cancelled, InputError
from ..io.file_lock import FileLock
from .job_runner import CANCEL
from .job_state import JobFolder, JobProgress, State, is_complete
from .jobs import Job
from .table import BatchTable
from .workers import JobHandle, open_pool

POLL_SECONDS = 0.2
LOCK = ".lock"


def batch_folder(path: Path) -> Path:
    """Return the folder of a batch (states and logs of its jobs): LIST.batch next to LIST.toml."""
    return path.resolve().with_suffix(".batch")


def run_batch(
    jobs: Sequence[Job],
    folder: Path,
    cancelled: Callable[[], bool],
    at_once: int = 1,
    dask: str | None = None,
) -> dict[str, State]:
    """Run all jobs, on this machine or on a Dask cluster, and return the final state of each by its name.

    Args:
        jobs: to run.
        folder: of the batch, see `batch_folder`.
        cancelled: asked again and again whether to stop.
        at_once: number of jobs that run at the same time on this machine.
        dask: address of a Dask scheduler; None: this machine.

    Raises:
        InputError: when another process works on the same list, or no scheduler answers.
        Cancelled: when `cancelled` returned True; every running job has then saved a checkpoint.
    """
    lock = _lock(folder)
    try:
        (folder / CANCEL).unlink(missing_ok=True)
        states = {job.name: _initial_state(job, JobFolder(folder / job.name)) for job in jobs}
        waiting = [job for job in jobs if states[job.name].state == "waiting"]
        for job in waiting:
            _save_waiting(JobFolder(folder / job.name), states[job.name])
        with open_pool(folder, at_once, dask) as pool:
            handles = {job.name: pool.submit(job) for job in waiting}
            _watch(handles, states, folder, cancelled)
    finally:
        lock.release()
    if any(state.state == "cancelled" for state in states.values()) or cancelled():
        done = sum(state.state == "done" for state in states.values())
        raise Cancelled(f"{done} of {len(jobs)} jobs are done; run the same command again to continue with the others")
    return states


def _lock(folder: Path) -> FileLock:
    """Create the folder of a batch and lock it against other processes."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
        return FileLock(folder / LOCK)
    except BlockingIOError:
        raise InputError(folder, "another process works on this list", "wait until it has ended") from None
    except OSError as error:
        raise InputError(folder, f"can't be written ({error.strerror})", "check the folder's permissions") from error


def _initial_state(job: Job, folder: JobFolder) -> State:
    """Return "done" if all steps of the job are complete, otherwise "waiting", however it ended the last time."""
    state = folder.read()
    done = all(is_complete(job, step, state) for step in job.steps)
    return replace(state, state="done" if done else "waiting", error="")


def _save_waiting(folder: JobFolder, state: State) -> None:
    """Save the state "waiting" over the "running" that a killed batch may have left."""
    folder.prepare()
    folder.write(state)


def _watch(handles: dict[str, JobHandle], states: dict[str, State], folder: Path, cancelled: Callable[[], bool]) -> None:
    """Update `states` and the table until all jobs have ended; cancelling creates a file, which the machines of a cluster see too."""
    stopping, running, table = False, dict(handles), BatchTable()
    while running:
        if cancelled() and not stopping:
            stopping = True
            (folder / CANCEL).touch()
            for handle in running.values():
                handle.withdraw()
        for name, handle in list(running.items()):
            if handle.done():
                states[name] = handle.result()
                del running[name]
            elif (saved := JobFolder(folder / name).read()).state == "running":
                states[name] = saved
        table.show(_rows(states, folder))
        time.sleep(POLL_SECONDS)
    table.show(_rows(states, folder), last=True)


def _rows(states: dict[str, State], folder: Path) -> list[tuple[str, State, JobProgress]]:
    """Return the rows of the table: name, state, and the progress of jobs that run."""
    return [
        (name, state, JobFolder(folder / name).progress() if state.state == "running" else JobProgress()) for name, state in states.items()
    ]
