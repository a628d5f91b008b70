# SPDX-License-Identifier: GPL-3.0-or-later
"""Child process that runs one command of a batch and ends with its parent: `launch.py core.cli.batch_child LOCK WORDS...`.

The command begins once the lock file LOCK is free: a process that still works on the same job, such as one whose worker was killed, has
ended then. When its stdin is closed, by the parent or by the parent's death, the command stops as after Ctrl-C: finished work is saved.
"""

from __future__ import annotations

import os
import signal
import sys
import threading
import time
from pathlib import Path

from ..io.file_lock import FileLock
from ..machine.parent_watch import on_parent_exit

GRACE_SECONDS = 60.0  # between the request to stop and the end of the process
POLL_SECONDS = 0.2


def main(arguments: list[str]) -> int:
    """Run the command in `arguments` (lock file, then the words after `irgspp`) and return its exit status."""
    lock, *words = arguments
    stopping = threading.Event()
    on_parent_exit(lambda: _stop(stopping))
    held = _wait_for(Path(lock), stopping)
    if held is None:
        return 130
    from .main import main as command

    try:
        return command(words)
    except KeyboardInterrupt:  # before the command handled signals
        return 130
    finally:
        held.release()


def _wait_for(path: Path, stopping: threading.Event) -> FileLock | None:
    """Return the lock as soon as it is free; None where the request to stop came first."""
    while not stopping.is_set():
        try:
            return FileLock(path)
        except BlockingIOError:
            time.sleep(POLL_SECONDS)
    return None


def _stop(stopping: threading.Event) -> None:
    """Ask the command to stop, and end the process where it does not stop in time."""
    stopping.set()
    signal.raise_signal(signal.SIGINT)
    time.sleep(GRACE_SECONDS)
    os._exit(130)


if __name__ == "__main__":
    try:
        sys.exit(main(sys.argv[1:]))
    except KeyboardInterrupt:
        sys.exit(130)
