# SPDX-License-Identifier: GPL-3.0-or-later
"""Session file of this Blender: a file that it keeps locked, so that other processes on the machine can tell whether it still runs.

The operating system frees the lock however Blender ends, and unlike a process number a file name is never used again.
"""

from __future__ import annotations

import os
import secrets
from collections.abc import Collection
from contextlib import suppress
from pathlib import Path

from ...core.io.file_lock import FileLock
from ..user_folder import user_folder

ENDING = ".session"

_held: dict[Path, FileLock] = {}  # at most one


def session_file() -> Path:
    """Return the session file of this process, which is created and locked at the first call."""
    for path in _held:
        return path
    path = user_folder("jobs") / f"{os.getpid()}-{secrets.token_hex(4)}{ENDING}"
    _held[path] = FileLock(path)
    return path


def end_session() -> None:
    """Release the lock and delete the session file: this process no longer manages its jobs."""
    for path, lock in list(_held.items()):
        lock.release()
        path.unlink(missing_ok=True)
    _held.clear()


def is_held(path: Path) -> bool:
    """Return True if any process, including this one, holds the lock of a file."""
    if path in _held:
        return True
    if not path.exists():
        return False
    try:
        FileLock(path).release()
    except BlockingIOError:
        return True
    except OSError:  # deleted meanwhile
        return False
    return False


def remove_unheld(folder: Path, owners: Collection[str]) -> None:
    """Delete the session files of ended processes that own no job.

    Args:
        folder: folder of the session files.
        owners: names of the session files that jobs refer to.
    """
    for file in folder.glob(f"*{ENDING}"):
        if file.name not in owners and not is_held(file):
            with suppress(OSError):  # Windows: another Blender is testing its lock
                file.unlink()
