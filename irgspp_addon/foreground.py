# SPDX-License-Identifier: GPL-3.0-or-later
"""A command of the engine on this process's own terminal: what asks this process to end asks the engine too, and once at most."""

from __future__ import annotations

import signal
import subprocess
import sys
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path

from ..core.errors import Cancelled
from ..core.lock import FileLock

WORKER = Path(__file__).with_name("worker.py")


def run_here(command: Sequence[str], environment: Mapping[str, str]) -> int:
    """Run `PYTHON SCRIPT ARGUMENTS` to its end and return its exit status: 130 where it was stopped, 1 where it crashed.

    Blender swallows Ctrl-C in background mode and leaves its children alone when it is terminated. So the engine is asked through
    a file, as often as one likes: a terminal sends the signal to both processes, `kill` to this one alone. It also stops when this
    process is killed without a word. Raises OSError where the program can't be started.
    """
    python, *words = command
    with tempfile.TemporaryDirectory(prefix="irgspp-", ignore_cleanup_errors=True) as folder:
        session, cancel = Path(folder, "session"), Path(folder, "cancel")
        lock = FileLock(session)
        try:
            process = subprocess.Popen([python, str(WORKER), folder, str(session), *words], env=dict(environment))
            with _asked_to_end(process, cancel):
                status = process.wait()
        finally:
            lock.release()
        if status >= 0:
            return status
        if cancel.exists():
            return Cancelled.exit_status
    name = signal.Signals(-status).name if -status in set(signal.Signals) else f"signal {-status}"
    print(f"irgspp: the engine was ended by {name}{', as when memory runs out' if name == 'SIGKILL' else ''}", file=sys.stderr)
    return 1


@contextmanager
def _asked_to_end(process: subprocess.Popen, cancel: Path) -> Iterator[None]:
    """Within the block the first Ctrl-C or SIGTERM asks the process to stop and save, the next one ends it."""

    def stop(number: int, frame: object) -> None:
        if cancel.exists():
            process.kill()
        else:
            cancel.touch()

    before = {kind: signal.signal(kind, stop) for kind in (signal.SIGINT, signal.SIGTERM)}
    try:
        yield
    finally:
        for kind, handler in before.items():
            signal.signal(kind, signal.SIG_DFL if handler is None else handler)  # None: Blender's own, which only Blender can set
