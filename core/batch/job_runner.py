# SPDX-License-Identifier: GPL-3.0-or-later
"""One job from where it is to its end, on whatever machine: its commands one after the other, each in a process of its own."""

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
from .job_state import JobFolder, State, is_there
from .jobs import Job

CANCEL = ".cancel"  # file in the folder of a batch: all of its jobs stop; no job is called so
LOOK_SECONDS = 0.2
THREADS = "IRGSPP_THREADS"


def work_off(job: Job, batch: Path, threads: int | None = None) -> State:
    """Do what is not done of a job and return how it ended; nothing that goes wrong is raised.

    batch: the folder of notes. threads: of the kernels, where the environment doesn't say. What a killed process left is gone on with
    from its last checkpoint.
    """
    folder = JobFolder(batch / job.name)
    state = State()
    try:
        folder.prepare()
        state = replace(folder.read(), state="running", error="")
        folder.write(state)
        for step in job.steps:
            if is_there(job, step, state):
                continue
            if (batch / CANCEL).exists():
                return _ended(folder, replace(state, state="cancelled"))
            began = time.monotonic()
            status, said = _run(step, job, folder, batch / CANCEL, threads)
            state = replace(state, seconds=round(state.seconds + time.monotonic() - began, 1))
            if status:
                return _ended(folder, replace(state, state="cancelled" if status == 130 else "failed", error="" if status == 130 else said))
            state = replace(state, finished=(*state.finished, tuple(step)))
            folder.write(state)
        return _ended(folder, replace(state, state="done"))
    except (OSError, IrgsppError) as error:
        return _ended(folder, replace(state, state="failed", error=" ".join(str(error).split())))


def _ended(folder: JobFolder, state: State) -> State:
    try:
        folder.write(state)
    except OSError as error:  # the disk is full or gone: whoever waits is told at least
        return replace(state, state="failed", error=f"{folder.path}: can't be written ({error.strerror})")
    return state


def _run(step: Sequence[str], job: Job, folder: JobFolder, cancel: Path, threads: int | None) -> tuple[int, str]:
    """One command to its end: exit status, and its last word."""
    words = list(step)
    if words[0] == "reconstruct" and (job.run / "run.json").is_file():
        words.append("--resume")
    (folder.path / "events.jsonl").unlink(missing_ok=True)
    with (folder.path / "log.txt").open("ab") as log:
        log.write(f"$ irgspp {' '.join(words)}\n".encode())
        log.flush()
        before = log.tell()
        process = subprocess.Popen(
            [sys.executable, str(LAUNCHER), "core.cli.batch_child", str(folder.path / "lock"), *words],
            stdin=subprocess.PIPE,
            stdout=log,
            stderr=subprocess.STDOUT,
            cwd=job.base,
            env=_environment(folder.path, threads),
            **_apart(),
        )
    status = _waited(process, cancel)
    said = folder.last_words(before)
    return status, said if status > 0 else f"its process was ended by signal {-status}{'; ' if said else ''}{said}"


def _waited(process: subprocess.Popen, cancel: Path) -> int:
    assert process.stdin is not None
    try:
        while process.poll() is None:
            if not process.stdin.closed and cancel.exists():
                process.stdin.close()
            time.sleep(LOOK_SECONDS)
    finally:
        process.stdin.close()
    return process.wait()


def _environment(notes: Path, threads: int | None) -> dict[str, str]:
    environment = {**os.environ, "IRGSPP_JOB": str(notes)}
    if threads is not None and THREADS not in environment:
        environment[THREADS] = str(threads)
    return environment


def _apart() -> dict[str, Any]:
    """Ctrl-C in the terminal reaches the batch alone, which then asks its processes in its own way."""
    if sys.platform == "win32":
        return {"creationflags": subprocess.CREATE_NEW_PROCESS_GROUP}
    return {"start_new_session": True}
