# SPDX-License-Identifier: GPL-3.0-or-later
"""The process of a job: started, looked after, ended; and what its end means."""

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

_processes: dict[str, subprocess.Popen] = {}  # of the jobs that this Blender started, by id


def spawn(job: Job, keep_running: bool) -> None:
    """Start the job's process. Raises OSError where that is not possible, InputError where no engine is chosen."""
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
        python, *words = engine_command(*job.arguments)
        return [python, *wrapped, *words]
    return [sys.executable, *bpy.app.python_args, *wrapped, job.program, *job.arguments]


def is_alive(job: Job) -> bool:
    """True while the job's process runs, whichever Blender started it."""
    process = _processes.get(job.id)
    if process is not None:
        return process.poll() is None
    return is_held(job.notes / "worker.lock")


def kill(job: Job) -> None:
    """End the process and those that it started, at once."""
    if not is_alive(job):
        return
    process = _processes.get(job.id)
    number = process.pid if process is not None else _read(job.notes / "worker.json").get("pid")
    if not isinstance(number, int):
        return
    try:
        if sys.platform == "win32":
            os.kill(number, signal.SIGTERM)  # ends it without asking, on Windows
        else:
            os.killpg(number, signal.SIGKILL)
    except OSError:
        return  # it ended by itself just now, for which Windows has an error of its own


def finish(job: Job) -> None:
    """Set state, error and time of end from how the process ended."""
    process, said = _processes.pop(job.id, None), _read(job.notes / "exit.json")
    status = said.get("status", process.returncode if process is not None else None)
    job.ended = said.get("ended") or time.time()
    job.read_events()
    if status == 0 and said:
        job.state, job.error = "done", None
    elif status == 130 or (job.stopping and not said):
        job.state, job.error = "cancelled", None
    elif status is None:
        job.state, job.error = "lost", "ended while Blender did not look, without saying how"
    else:
        job.state, job.error = "failed", _reason(job, status, bool(said))


def _reason(job: Job, status: int, orderly: bool) -> str:
    """Why it failed, in one line: the engine's own last word, or how the process ended."""
    lines = job.log_tail(50)
    if orderly:
        own = [line.removeprefix("irgspp: ") for line in lines if line.startswith("irgspp: ")]
        return own[-1] if own else (lines[-1].strip() if lines else f"ended with status {status} and no message")
    if status < 0:
        return f"{ended_by(-status)}; the log's last lines say what it did"
    return f"the engine ended with status {status}: {lines[-1].strip() if lines else 'no message'}"


def _read(path: Path) -> dict:
    try:
        values = json.loads(path.read_text("utf-8"))
    except (OSError, ValueError):
        return {}
    return values if isinstance(values, dict) else {}
