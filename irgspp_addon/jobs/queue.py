# SPDX-License-Identifier: GPL-3.0-or-later
"""All jobs: started, queued, watched, stopped, and found again after Blender or a file was closed."""

from __future__ import annotations

import shutil
import time
from collections.abc import Callable, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any

from ...core.errors import InputError, IrgsppError
from ...core.io.file_lock import FileLock
from ..engine.interrupts import on_interrupt
from ..engine.process import keep_running, require_engine
from ..user_folder import user_folder
from .job import Job, load_job, new_job
from .process import finish, is_alive, kill, spawn
from .session import ENDING, is_held, session_file

AT_ONCE = ("check", "inspect", "export")  # short ones, which need not wait for the long ones
WRITERS = ("reconstruct", "demo", "bake")  # at most one in a folder
HISTORY = 50  # finished jobs that are remembered
ADOPTION_SECONDS = 5.0

ON_DONE: dict[str, Callable[[Job], None]] = {}  # by name, so that a job keeps its wish on disk
ON_END: dict[str, Callable[[Job], None]] = {}  # by kind: called whatever the end was
CHANGED: list[Callable[[Sequence[str]], None]] = []  # told the ids, newest first, when jobs come or go

_jobs: dict[str, Job] = {}
_looked = 0.0


def start(
    kind: str,
    title: str,
    folder: Path | None,
    arguments: Sequence[str],
    on_done: str | None = None,
    data: dict[str, Any] | None = None,
    program: str = "engine",
) -> Job:
    """Queue a job, which begins at once where nothing stands before it.

    folder: what it works on, None for nothing but its own notes. arguments: the words after `irgspp`. on_done: see ON_DONE. program:
    a script that Blender's own Python runs instead of the engine.

    Raises InputError where there is no engine, or another job or process works in the folder; IrgsppError where nothing can be written.
    """
    if program == "engine" and kind != "check":
        require_engine()
    if folder is not None and kind in WRITERS:
        check_free(folder)
    try:
        values = {"on_done": on_done, "data": data or {}, "program": program, "arguments": [str(a) for a in arguments]}
        job = new_job(jobs_folder(), kind, title, folder, owner=session_file().name, **values)
        job.save()
    except OSError as error:
        raise IrgsppError(f"the job can't be noted down in {jobs_folder()}: {error.strerror or error}") from error
    _jobs[job.id] = job
    _trim()
    _tell()
    _start_queued()
    return job


def check_free(folder: Path) -> None:
    """Raise InputError where another job, of this Blender or any other program, writes into the folder."""
    for job in _jobs.values():
        if not job.finished and job.kind in WRITERS and job.folder.resolve() == folder.resolve():
            fix = "wait for it, cancel it, or name another folder"
            raise InputError(folder, f"the job {job.title} is {job.state} for this folder", fix)
    if (folder / ".lock").exists():
        try:
            FileLock(folder / ".lock").release()
        except BlockingIOError:
            raise InputError(folder, "is in use by another Blender or program", "wait for it or name another folder") from None
        except OSError as error:
            raise InputError(folder, f"can't be written ({error.strerror})") from error


def all_jobs() -> list[Job]:
    """Every job that is remembered, the newest first."""
    return sorted(_jobs.values(), key=lambda job: (job.made, job.id), reverse=True)


def find(identifier: str) -> Job | None:
    """The job of that id."""
    return _jobs.get(identifier)


def running() -> list[Job]:
    """Those whose process runs now."""
    return [job for job in all_jobs() if job.state == "running"]


def unfinished() -> bool:
    """True while any job is queued or running."""
    return any(not job.finished for job in _jobs.values())


# --- wishes


def cancel(job: Job) -> None:
    """Ask the job to stop after saving what it has; asked again, it is ended at once."""
    if job.finished:
        return
    if job.state == "queued" and _mine(job):
        _end_queued(job)
        return
    if job.stopping:
        kill(job)
    job.wish("cancel")
    job.stopping, job.message = True, "stopping; what is done is being saved"


def finish_early(job: Job) -> None:
    """Ask the job to be content with the present phase and go on with the next."""
    if not job.can_finish_early:
        raise InputError(job.title, "is not optimising anything", "only a running reconstruction can finish early")
    job.wish("finish")
    job.message = "going on to the next phase"


def resume(job: Job) -> None:
    """Go on with a stopped reconstruction where it was."""
    if not job.resumable:
        raise InputError(job.title, f"is {job.state}, which can't be resumed", "start it anew")
    require_engine()
    check_free(job.folder)
    job.arguments = [a for a in job.arguments if a not in ("--resume", "--overwrite")] + ["--resume"]
    (job.notes / "cancel").unlink(missing_ok=True)
    job.state, job.owner, job.error, job.message, job.stopping, job.ended = "queued", session_file().name, None, "", False, None
    job.save_if_possible()
    _start_queued()


def forget(job: Job) -> None:
    """Drop a finished job and its notes; the results stay where they are."""
    if not job.finished:
        raise InputError(job.title, f"is {job.state}", "cancel it first")
    shutil.rmtree(job.notes, ignore_errors=True)
    _jobs.pop(job.id, None)
    _tell()


def wait(job: Job, timeout: float | None = None, watch: Callable[[Job], None] | None = None) -> Job:
    """Block until the job has ended, for scripts; `watch` is called after every look. Raises TimeoutError.

    The first Ctrl-C or SIGTERM cancels the job, the second ends it at once.
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


# --- watching


def poll() -> bool:
    """Look at every unfinished job once and start what is next; True where anything changed. Cheap: a few file look-ups per job."""
    global _looked
    changed = False
    for job in list(_jobs.values()):
        if job.state == "running":
            changed |= _watch(job)
        elif job.state == "queued" and not _mine(job):
            job.reload()
            changed |= job.state != "queued"
    if time.monotonic() - _looked > ADOPTION_SECONDS and any(not job.finished and not _mine(job) for job in _jobs.values()):
        _adopt()
    changed = _start_queued() or changed
    if changed and _trim():
        _tell()
    return changed


def refresh() -> None:
    """Read the jobs that are noted on disk: after a start of Blender, when a file was loaded, or to see what another Blender does."""
    for file in jobs_folder().glob("*/job.json"):
        if file.parent.name not in _jobs and (job := load_job(file.parent)) is not None:
            _jobs[job.id] = job
            job.read_events()
    _adopt()
    _trim()
    _tell()


def jobs_folder() -> Path:
    """Where the notes of all jobs are."""
    return user_folder("jobs")


def clear() -> None:
    """Forget all in memory, nothing on disk."""
    _jobs.clear()


def _watch(job: Job) -> bool:
    changed = job.read_events()
    if is_alive(job):
        return changed
    if not _mine(job):
        job.reload()  # the Blender that looks after it says how it ended
        return job.state != "running" or changed
    finish(job)
    job.save_if_possible()
    if job.kind in ON_END:
        _call(ON_END[job.kind], job)
    if job.state == "done" and job.on_done in ON_DONE:
        _call(ON_DONE[job.on_done], job)
    return True


def _call(function: Callable[[Job], None], job: Job) -> None:
    """What is to happen in Blender at a job's end; a failure there is told and spoils nothing."""
    try:
        function(job)
    except Exception as error:  # whatever it is: the timer must go on
        job.error = " ".join(f"{job.state}, but: {error or type(error).__name__}".split())
        job.save_if_possible()


def _start_queued() -> bool:
    """Start what is next, and all short ones."""
    changed = False
    for job in reversed(all_jobs()):
        if job.state != "queued" or not _mine(job):
            continue
        if (job.notes / "cancel").exists():
            _end_queued(job)
            changed = True
        elif job.kind in AT_ONCE or not any(j.kind not in AT_ONCE and _mine(j) for j in running()):
            _begin(job)
            changed = True
    return changed


def _begin(job: Job) -> None:
    try:
        job.phase, job.step, job.of, job.eta, job.figures, job.preview, job._read = "", 0, 0, None, {}, None, 0
        job.state, job.began = "running", time.time()
        job.save()
        spawn(job, keep_running())
    except (IrgsppError, OSError) as error:
        job.state, job.ended = "failed", time.time()
        told = isinstance(error, IrgsppError)
        job.error = str(error) if told else f"{error.filename or 'the engine'}: can't be started ({error.strerror or error})"
        job.save_if_possible()


def _end_queued(job: Job) -> None:
    job.state, job.ended = "cancelled", time.time()
    job.save_if_possible()


def _mine(job: Job) -> bool:
    return job.owner == session_file().name


def _adopt() -> None:
    """Look after the jobs of Blenders that have ended."""
    global _looked
    _looked = time.monotonic()
    for job in _jobs.values():
        if job.finished or _mine(job) or is_held(jobs_folder() / job.owner):
            continue
        job.reload()
        if not job.finished and not is_held(jobs_folder() / job.owner):  # else another Blender was faster
            job.owner = session_file().name
            job.save_if_possible()
    owners = {job.owner for job in _jobs.values()}
    for file in jobs_folder().glob(f"*{ENDING}"):
        if file.name not in owners and not is_held(file):
            with suppress(OSError):  # Windows: another Blender looks at it just now
                file.unlink()


def _trim() -> bool:
    """Keep the history short; True where a job was forgotten."""
    old = [job for job in all_jobs() if job.finished][HISTORY:]
    for job in old:
        shutil.rmtree(job.notes, ignore_errors=True)
        del _jobs[job.id]
    return bool(old)


def _tell() -> None:
    ids = [job.id for job in all_jobs()]
    for listener in CHANGED:
        listener(ids)
