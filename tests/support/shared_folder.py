# SPDX-License-Identifier: GPL-3.0-or-later
"""Folder that all processes of one test run share, and what one of them makes there for all."""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path

import pytest
from irgspp.core.io.file_lock import FileLock


def shared_folder(factory: pytest.TempPathFactory) -> Path:
    """Return the temporary folder of the whole test run; of several processes, each has its own folder in it."""
    base = factory.getbasetemp()
    return base.parent if base.name.startswith("popen") else base


def made_once(folder: Path, make: Callable[[Path], object]) -> Path:
    """Return a folder that the first process fills, and that the others wait for; where it fails, the next one tries.

    Args:
        folder: it lies in the folder that all processes share.
        make: called with the folder, which exists.
    """
    folder.mkdir(parents=True, exist_ok=True)
    done, lock = folder / "done", None
    while not done.exists() and lock is None:
        try:
            lock = FileLock(folder / "lock")
        except BlockingIOError:
            time.sleep(0.2)
    if lock is None:
        return folder
    try:
        if not done.exists():
            make(folder)
            done.touch()
    finally:
        lock.release()
    return folder
