# SPDX-License-Identifier: GPL-3.0-or-later
"""Lock file between processes, which the operating system frees when the process that holds it ends."""

from __future__ import annotations

import os
import sys
from pathlib import Path


class FileLock:
    """Lock of a file, held from construction until `release`; construction raises BlockingIOError if another process holds it."""

    def __init__(self, path: Path) -> None:
        self._file = os.open(path, os.O_RDWR | os.O_CREAT, 0o644)
        try:
            _lock(self._file)
        except OSError as error:
            self.release()
            raise BlockingIOError(str(path)) from error

    def release(self) -> None:
        """Free the lock; a second call has no effect."""
        if self._file >= 0:
            os.close(self._file)
            self._file = -1


if sys.platform == "win32":
    import msvcrt

    def _lock(descriptor: int) -> None:
        msvcrt.locking(descriptor, msvcrt.LK_NBLCK, 1)
else:
    import fcntl

    def _lock(descriptor: int) -> None:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
