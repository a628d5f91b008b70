# SPDX-License-Identifier: GPL-3.0-or-later
"""Commands of the engine in the foreground: interrupts of this process are passed on to the engine, which can then stop in order."""

from __future__ import annotations

import subprocess
import sys
import tempfile
from collections.abc import Mapping, Sequence
from pathlib import Path

from ...core.errors import Cancelled
from ...core.io.file_lock import FileLock
from .child import ended_by
from .interrupts import on_interrupt

WORKER = Path(__file__).with_name("worker.py")


def run_here(command: Sequence[str], environment: Mapping[str, str]) -> int:
    """Run a program in the foreground until it ends.

    Blender ignores Ctrl-C in background mode and does not stop its children when it is terminated. The first interrupt therefore
    requests a stop through a file (a terminal sends the signal to both processes, `kill` only to this one); the second interrupt
    kills the program. The program also stops in order when this process is killed, because the file lock of its session is freed.

    Args:
        command: command line, PYTHON SCRIPT ARGUMENTS.
        environment: environment variables of the program.

    Returns:
        Exit status of the program; 130 if it was stopped, 1 if it crashed.

    Raises:
        OSError: if the program can't be started.
    """
    python, *arguments = command
    with tempfile.TemporaryDirectory(prefix="irgspp-", ignore_cleanup_errors=True) as folder:
        session, cancel = Path(folder, "session"), Path(folder, "cancel")
        lock = FileLock(session)
        try:
            process = subprocess.Popen([python, str(WORKER), folder, str(session), *arguments], env=dict(environment))
            with on_interrupt(lambda: process.kill() if cancel.exists() else cancel.touch()):
                status = process.wait()
        finally:
            lock.release()
        if status >= 0:
            return status
        if cancel.exists():
            return Cancelled.exit_status
    print(f"irgspp: {ended_by(-status)}", file=sys.stderr)
    return 1
