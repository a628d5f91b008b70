# SPDX-License-Identifier: GPL-3.0-or-later
"""A command of the engine on this process's own terminal: what asks this process to end asks the engine too, and once at most."""

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
    """Run `PYTHON SCRIPT ARGUMENTS` to its end and return its exit status: 130 where it was stopped, 1 where it crashed.

    Blender swallows Ctrl-C in background mode and leaves its children alone when it is terminated. So the engine is asked through
    a file, as often as one likes: a terminal sends the signal to both processes, `kill` to this one alone. A second request ends it
    at once. It also stops when this process is killed without a word. Raises OSError where the program can't be started.
    """
    python, *words = command
    with tempfile.TemporaryDirectory(prefix="irgspp-", ignore_cleanup_errors=True) as folder:
        session, cancel = Path(folder, "session"), Path(folder, "cancel")
        lock = FileLock(session)
        try:
            process = subprocess.Popen([python, str(WORKER), folder, str(session), *words], env=dict(environment))
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
