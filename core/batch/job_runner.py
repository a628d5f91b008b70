# SPDX-License-Identifier: GPL-3.0-or-later
"""Runner of one job, on any machine: executes its remaining commands in order, each in a child process."""

from __future__ import annotations

import os
import subprocess
import sys
import time
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from ..errors import IrgsppError
from ..machine.blender_process import LAUNCHER
from .job_state import JobFolder, State, is_complete
from .jobs import Job

CANCEL = ".cancel"  # file in the folder of a batch that stops all of its jobs; no job's name begins with a dot
POLL_SECONDS = 0.2
THREADS = "IRGSPP_THREADS"


def run_job(job: Job, batch: Path, threads: int | None = None) -> State:
    """Run the steps of a job that are not complete and return its final state; failures are part of it and never raised.

    A reconstruction that was interrupted resumes from its last checkpoint.

    Args:
        job: to run.
        batch: folder of the batch.
        threads: of the kernels, unless the environment sets IRGSPP_THREADS; None: all cores.
    """
    folder = JobFolder(batch / job.name)
    state = State()
    try:
        folder.prepare()
        state = replace(folder.read(), state="running", error="")
        folder.write(state)
        for number, step in enumerate(job.steps):
            if is_complete(job, step, state):
                continue
            if (batch / CANCEL).exists():
                return _ended(folder, replace(state, state="cancelled"))
            began = time.monotonic()
            status, message = _run(step, job, folder, batch / CANCEL, threads)
            state = replace(state, seconds=round(state.seconds + time.monotonic() - began, 3))
            if status:
                return _ended(
                    folder, replace(state, state="cancelled" if status == 130 else "failed", error="" if status == 130 else message)
                )
            # What later steps made of the former result is no longer true.
            state = replace(state, finished=(*(done for done in state.finished if done in job.steps[:number]), tuple(step)))
            folder.write(state)
        return _ended(folder, replace(state, state="done"))
    except (OSError, IrgsppError) as error:
        return _ended(folder, replace(state, state="failed", error=" ".join(str(error).split())))


def _ended(folder: JobFolder, state: State) -> State:
    """Save the final state of a job and return it."""
    try:
        folder.write(state)
    except OSError as error:  # the disk is full or gone: at least the batch gets to know
        return replace(state, state="failed", error=f"{folder.path}: can't be written ({error.strerror})")
    return state


def _run(step: Sequence[str], job: Job, folder: JobFolder, cancel: Path, threads: int | None) -> tuple[int, str]:
    """Run one command and return its exit status and its last message."""
    arguments = list(step)
    if arguments[0] == "reconstruct" and (job.run / "run.json").is_file():
        arguments.append("--resume")
    (folder.path / "events.jsonl").unlink(missing_ok=True)
    with (folder.path / "log.txt").open("ab") as log:
        log.write(f"$ irgspp {' '.join(arguments)}\n".encode())
        log.flush()
        before = log.tell()
        process = subprocess.Popen(
            [sys.executable, str(LAUNCHER), "core.cli.batch_child", str(folder.path / "lock"), *arguments],
            stdin=subprocess.PIPE,
            stdout=log,
            stderr=subprocess.STDOUT,
            cwd=job.base,
            env=_environment(folder.path, threads),
            **_own_process_group(),
        )
    status = _wait(process, cancel)
    message = folder.last_message(before)
    return status, message if status > 0 else f"its process was ended by signal {-status}{'; ' if message else ''}{message}"


def _wait(process: subprocess.Popen, cancel: Path) -> int:
    """Wait for a process and return its exit status; closes its stdin, which stops it, once the file `cancel` exists."""
    assert process.stdin is not None
    try:
        while process.poll() is None:
            if not process.stdin.closed and cancel.exists():
                process.stdin.close()
            time.sleep(POLL_SECONDS)
    finally:
        process.stdin.close()
    return process.wait()


def _environment(folder: Path, threads: int | None) -> dict[str, str]:
    """Return the environment of a child process, which writes its events into `folder`."""
    environment = {**os.environ, "IRGSPP_JOB": str(folder)}
    if threads is not None and THREADS not in environment:
        environment[THREADS] = str(threads)
    return environment


def _own_process_group() -> dict[str, Any]:
    """Keep Ctrl-C in the terminal from the child: it reaches the batch alone, which then stops its children through their stdin."""
    if sys.platform == "win32":
        return {"creationflags": subprocess.CREATE_NEW_PROCESS_GROUP}
    return {"start_new_session": True}
