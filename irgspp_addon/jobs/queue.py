# SPDX-License-Identifier: GPL-3.0-or-later
"""Job queue: starts, observes and stops jobs, and finds them again after Blender or a file was closed."""

from __future__ import annotations

import shutil
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from ...core.errors import InputError, IrgsppError
from ..engine.interrupts import on_interrupt
from ..engine.process import keep_running, require_engine
from ..translations import translated
from ..user_folder import user_folder
from .folder_check import WRITERS, check_free
from .job import Job, load_job, new_job
from .process import finish, is_alive, kill, spawn
from .session import is_held, remove_unheld, session_file

AT_ONCE = ("check", "inspect", "export")  # kinds of short jobs, which do not wait for long ones
HISTORY = 50  # number of finished jobs in the list
ADOPTION_SECONDS = 5.0  # between searches for jobs of ended Blenders

ON_DONE: dict[str, Callable[[Job], None]] = {}  # called after success, by the name that a job stores on disk
ON_END: dict[str, Callable[[Job], None]] = {}  # called after any end; by kind of job
CHANGED: list[Callable[[Sequence[str]], None]] = []  # called with the ids, newest first, when jobs are added or removed

_jobs: dict[str, Job] = {}
_last_adoption = 0.0  # monotonic time in seconds


def start(
    kind: str,
    title: str,
    folder: Path | None,
    arguments: Sequence[str],
    on_done: str | None = None,
    data: dict[str, Any] | None = None,
    program: str = "engine",
) -> Job:
    """Queue a job; it begins at once if no other job is before it.

    Args:
        kind: kind of the job, see `Job`.
        title: text in the list of jobs.
        folder: folder that the job reads or writes; None for its private folder alone.
        arguments: command-line arguments of `irgspp`, or of the script.
        on_done: name of a function in ON_DONE.
        data: JSON data for that function.
        program: "engine", or the path of a script that Blender's own Python runs.

    Raises:
        InputError: if there is no engine, or another job or process writes into the folder.
        IrgsppError: if the job's files can't be written.
    """
    if program == "engine" and kind != "check":
        require_engine()
    if folder is not None and kind in WRITERS:
        check_free(folder, _jobs.values())
    try:
        values = {"on_done": on_done, "data": data or {}, "program": program, "arguments": [str(a) for a in arguments]}
        job = new_job(jobs_folder(), kind, title, folder, owner=session_file().name, **values)
        job.save()
    except OSError as error:
        raise IrgsppError(f"the job can't be saved in {jobs_folder()}: {error.strerror or error}") from error
    _jobs[job.id] = job
    _trim()
    _notify()
    _start_queued()
    return job


def all_jobs() -> list[Job]:
    """Return all jobs in the list, the newest first."""
    return sorted(_jobs.values(), key=lambda job: (job.made, job.id), reverse=True)


def find(identifier: str) -> Job | None:
    """Return the job with this id, or None."""
    return _jobs.get(identifier)


def running() -> list[Job]:
    """Return the jobs whose process is running."""
    return [job for job in all_jobs() if job.state == "running"]


def unfinished() -> bool:
    """Return True while any job is queued or running."""
    return any(not job.finished for job in _jobs.values())


# --- requests


def cancel(job: Job) -> None:
    """Request that the job saves its progress and stops; a second request kills it."""
    if job.finished:
        return
    if job.state == "queued" and _is_own(job):
        _end_queued(job)
        return
    if job.stopping:
        kill(job)
    job.request("cancel")
    job.stopping, job.message = True, translated("stopping; the progress is being saved")


def finish_early(job: Job) -> None:
    """Request that a reconstruction ends its current phase early and continues with the next; raise InputError for other jobs."""
    if not job.can_finish_early:
        raise InputError(job.title, "is not optimising anything", "only a running reconstruction can finish early")
    job.request("finish")
    job.message = translated("continuing with the next phase")


def resume(job: Job) -> None:
    """Continue a stopped reconstruction or capture where it stopped; raise InputError for other jobs, or if its folder is in use."""
    if not job.resumable:
        raise InputError(job.title, f"is {job.state}, which can't be resumed", "start a new job")
    require_engine()
    check_free(job.folder, _jobs.values())
    if job.kind != "capture":  # which goes on by itself
        job.arguments = [a for a in job.arguments if a not in ("--resume", "--overwrite")] + ["--resume"]
    (job.notes / "cancel").unlink(missing_ok=True)
    job.state, job.owner, job.error, job.message, job.stopping, job.ended = "queued", session_file().name, None, "", False, None
    job.save_if_possible()
    _start_queued()


def forget(job: Job) -> None:
    """Remove a finished job from the list and delete its private folder, not its results; raise InputError if it has not ended."""
    if not job.finished:
        raise InputError(job.title, f"is {job.state}", "cancel it first")
    shutil.rmtree(job.notes, ignore_errors=True)
    _jobs.pop(job.id, None)
    _notify()


def wait(job: Job, timeout: float | None = None, watch: Callable[[Job], None] | None = None) -> Job:
    """Wait until the job has ended and return it, for scripts; the first Ctrl-C or SIGTERM cancels the job, the second kills it.

    Args:
        job: job to wait for.
        timeout: seconds to wait at most; None waits for ever.
        watch: function called with the job after every update.

    Raises:
        TimeoutError: if the job has not ended in time.
    """
    began = time.monotonic()
    with on_interrupt(lambda: cancel(job)):
        while not job.finished:
            poll()
            if watch is not None:
                watch(job)
            if timeout is not None and time.monotonic() - began > timeout:
                raise TimeoutError(f"{job.title} has not ended after {timeout:g} s")
            time.sleep(0.05)
    return job


# --- updates


def poll() -> bool:
    """Update all unfinished jobs, start the next ones, and return True if anything changed; it costs a few file look-ups per job."""
    changed = False
    for job in list(_jobs.values()):
        if job.state == "running":
            changed |= _update(job)
        elif job.state == "queued" and not _is_own(job):
            job.reload()
            changed |= job.state != "queued"
    due = time.monotonic() - _last_adoption > ADOPTION_SECONDS
    if due and any(not job.finished and not _is_own(job) for job in _jobs.values()):
        _adopt()
    changed = _start_queued() or changed
    if changed and _trim():
        _notify()
    return changed


def refresh() -> None:
    """Read all jobs on disk: after Blender has started or loaded a file, or to see the jobs of another Blender."""
    for file in jobs_folder().glob("*/job.json"):
        if file.parent.name not in _jobs and (job := load_job(file.parent)) is not None:
            _jobs[job.id] = job
            job.read_events()
    _adopt()
    _trim()
    _notify()


def jobs_folder() -> Path:
    """Return the folder that holds the private folders of all jobs."""
    return user_folder("jobs")


def clear() -> None:
    """Forget all jobs in memory; their files stay on disk."""
    _jobs.clear()


def _update(job: Job) -> bool:
    """Update a running job and return True if anything changed."""
    changed = job.read_events()
    if is_alive(job):
        return changed
    if not _is_own(job):
        job.reload()  # the Blender that owns the job writes its final state
        return job.state != "running" or changed
    finish(job)
    job.save_if_possible()
    if job.kind in ON_END:
        _call(ON_END[job.kind], job)
    if job.state == "done" and job.on_done in ON_DONE:
        _call(ON_DONE[job.on_done], job)
    return True


def _call(function: Callable[[Job], None], job: Job) -> None:
    """Call a function at a job's end; its failure becomes the job's error and does not stop the queue."""
    try:
        function(job)
    except Exception as error:  # any error, because the timer must go on
        job.error = " ".join(f"{job.state}, but: {error or type(error).__name__}".split())
        job.save_if_possible()


def _start_queued() -> bool:
    """Start the next long job if none is running, and all short jobs; return True if anything changed."""
    changed = False
    for job in reversed(all_jobs()):
        if job.state != "queued" or not _is_own(job):
            continue
        if (job.notes / "cancel").exists():
            _end_queued(job)
            changed = True
        elif job.kind in AT_ONCE or not any(j.kind not in AT_ONCE and _is_own(j) for j in running()):
            _begin(job)
            changed = True
    return changed


def _begin(job: Job) -> None:
    try:
        job.phase, job.step, job.of, job.eta, job.metrics, job.preview, job._read = "", 0, 0, None, {}, None, 0
        job.state, job.began = "running", time.time()
        job.save()
        spawn(job, keep_running())
    except (IrgsppError, OSError) as error:
        job.state, job.ended = "failed", time.time()
        described = isinstance(error, IrgsppError)
        job.error = str(error) if described else f"{error.filename or 'the engine'}: can't be started ({error.strerror or error})"
        job.save_if_possible()


def _end_queued(job: Job) -> None:
    job.state, job.ended = "cancelled", time.time()
    job.save_if_possible()


def _is_own(job: Job) -> bool:
    return job.owner == session_file().name


def _adopt() -> None:
    """Take over the unfinished jobs of Blenders that have ended, and delete the session files of ended Blenders."""
    global _last_adoption
    _last_adoption = time.monotonic()
    for job in _jobs.values():
        if job.finished or _is_own(job) or is_held(jobs_folder() / job.owner):
            continue
        job.reload()
        if not job.finished and not is_held(jobs_folder() / job.owner):  # else another Blender has taken it over meanwhile
            job.owner = session_file().name
            job.save_if_possible()
    remove_unheld(jobs_folder(), {job.owner for job in _jobs.values()})


def _trim() -> bool:
    """Remove finished jobs beyond HISTORY, and return True if there were any."""
    old = [job for job in all_jobs() if job.finished][HISTORY:]
    for job in old:
        shutil.rmtree(job.notes, ignore_errors=True)
        del _jobs[job.id]
    return bool(old)


def _notify() -> None:
    """Call the listeners of CHANGED."""
    ids = [job.id for job in all_jobs()]
    for listener in CHANGED:
        listener(ids)
