# SPDX-License-Identifier: GPL-3.0-or-later
"""This Blender among others on the same machine: a file that it keeps locked, so that anyone can tell whether it still runs.

The operating system frees the lock however Blender ends, and unlike a process number a file name is never used again.
"""

from __future__ import annotations

import os
import secrets
from pathlib import Path

from ...core.io.file_lock import FileLock
from ..user_folder import user_folder

ENDING = ".session"

_held: dict[Path, FileLock] = {}  # at most one


def session_file() -> Path:
    """The file that this process keeps locked; made and locked at the first call."""
    for path in _held:
        return path
    path = user_folder("jobs") / f"{os.getpid()}-{secrets.token_hex(4)}{ENDING}"
    _held[path] = FileLock(path)
    return path


def end_session() -> None:
    """Give the lock back: this process no longer looks after its jobs."""
    for path, lock in list(_held.items()):
        lock.release()
        path.unlink(missing_ok=True)
    _held.clear()


def is_held(path: Path) -> bool:
    """True where some process, be it this one, holds the lock of a file."""
    if path in _held:
        return True
    if not path.exists():
        return False
    try:
        FileLock(path).release()
    except BlockingIOError:
        return True
    except OSError:  # gone meanwhile
        return False
    return False
