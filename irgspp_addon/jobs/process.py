# SPDX-License-Identifier: GPL-3.0-or-later
"""Process of a job: start, observation, forced end, and the job's final state from its exit status."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import bpy

from ..engine.child import detached, ended_by
from ..engine.process import engine_command, engine_environment
from .job import Job
from .session import is_held, session_file

WORKER = Path(__file__).resolve().parents[1] / "engine" / "worker.py"
CLOSED = "Blender was closed"  # as the error of a job that stopped with it
BLENDER_ENDED = "irgspp: Blender has ended"  # line of its log; see worker.py

_processes: dict[str, subprocess.Popen] = {}  # by job id, of the jobs that this Blender started


def spawn(job: Job, keep_running: bool) -> None:
    """Start the job's process.

    Args:
        job: job to start.
        keep_running: True if the process continues after this Blender has ended.

    Raises:
        OSError: if the process can't be started or its files can't be written.
        InputError: if no engine is chosen.
    """
    for name in ("cancel", "finish", "exit.json", "worker.json", "events.jsonl", "output.txt"):
        (job.notes / name).unlink(missing_ok=True)
    if keep_running:
        (job.notes / "keep").touch()
    with (job.notes / "output.txt").open("wb") as output, job.log.open("wb") as log:
        _processes[job.id] = subprocess.Popen(
            _command(job), stdin=subprocess.DEVNULL, stdout=output, stderr=log, env=engine_environment(), **detached()
        )


def _command(job: Job) -> list[str]:
    wrapped = [str(WORKER), str(job.notes), str(session_file())]
    if job.program == "engine":
        python, *arguments = engine_command(*job.arguments)
        return [python, *wrapped, *arguments]
    return [sys.executable, *bpy.app.python_args, *wrapped, job.program, *job.arguments]


def is_alive(job: Job) -> bool:
    """Return True while the job's process runs, whichever Blender started it."""
    process = _processes.get(job.id)
    if process is not None:
        return process.poll() is None
    return is_held(job.notes / "worker.lock")


def kill(job: Job) -> None:
    """Kill the job's process and the processes that it started."""
    if not is_alive(job):
        return
    process = _processes.get(job.id)
    number = process.pid if process is not None else _read(job.notes / "worker.json").get("pid")
    if not isinstance(number, int):
        return
    try:
        if sys.platform == "win32":
            os.kill(number, signal.SIGTERM)  # on Windows this ends the process at once
        else:
            os.killpg(number, signal.SIGKILL)
    except OSError:
        return  # the process has just ended by itself; Windows has its own error for that


def finish(job: Job) -> None:
    """Set the job's state, error and time of end from the exit status of its process."""
    process, record = _processes.pop(job.id, None), _read(job.notes / "exit.json")
    status = record.get("status", process.returncode if process is not None else None)
    job.ended = record.get("ended") or time.time()
    job.read_events()
    if status == 0 and record:
        job.state, job.error = "done", None
    elif status == 130 or (job.stopping and not record):
        job.state, job.error = "cancelled", CLOSED if _ended_with_blender(job) else None
    elif status is None:
        job.state, job.error = "lost", "ended without an exit status while no Blender observed it; its log may say why"
    else:
        job.state, job.error = "failed", _reason(job, status, bool(record))


def _ended_with_blender(job: Job) -> bool:
    """Return True where the job stopped because its Blender was closed, which worker.py writes to the log."""
    return any(BLENDER_ENDED in line for line in job.log_tail(50))


def _reason(job: Job, status: int, has_record: bool) -> str:
    """Return the reason of a failure in one line: the engine's last message, or the signal that ended the process."""
    lines = job.log_tail(50)
    if has_record:
        own = [line.removeprefix("irgspp: ") for line in lines if line.startswith("irgspp: ")]
        return own[-1] if own else (lines[-1].strip() if lines else f"ended with status {status} and no message")
    if status < 0:
        return f"{ended_by(-status)}; the last lines of the log show what it was doing"
    return f"the engine ended with status {status}: {lines[-1].strip() if lines else 'no message'}"


def _read(path: Path) -> dict:
    try:
        values = json.loads(path.read_text("utf-8"))
    except (OSError, ValueError):
        return {}
    return values if isinstance(values, dict) else {}
