# SPDX-License-Identifier: GPL-3.0-or-later
"""A command in a process of its own that ends with the one that started it: `launch.py core.cli.batch_child LOCK WORDS...`.

The command begins once it has LOCK: another process that still works on the same job, as one whose worker was killed, has ended then.
At the end of its stdin it stops as after Ctrl-C: what is done is saved. That is how the parent asks for it, and what its death means.
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

GRACE_SECONDS = 60.0  # between asking the command to stop and ending it
LOOK_SECONDS = 0.2


def main(arguments: list[str]) -> int:
    """Run the command; its exit status."""
    lock, *words = arguments
    asked = threading.Event()
    on_parent_exit(lambda: _stop(asked))
    held = _patiently(Path(lock), asked)
    if held is None:
        return 130
    from .main import main as command

    try:
        return command(words)
    except KeyboardInterrupt:  # before the command listened
        return 130
    finally:
        held.release()


def _patiently(path: Path, asked: threading.Event) -> FileLock | None:
    """The lock, as soon as it is free; None where the end came first."""
    while not asked.is_set():
        try:
            return FileLock(path)
        except BlockingIOError:
            time.sleep(LOOK_SECONDS)
    return None


def _stop(asked: threading.Event) -> None:
    """Ask the command to stop, and end it where it doesn't."""
    asked.set()
    signal.raise_signal(signal.SIGINT)
    time.sleep(GRACE_SECONDS)
    os._exit(130)


if __name__ == "__main__":
    try:
        sys.exit(main(sys.argv[1:]))
    except KeyboardInterrupt:
        sys.exit(130)
