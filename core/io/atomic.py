# SPDX-License-Identifier: GPL-3.0-or-later
"""Files that appear whole or not at all, whatever ends the process or the machine, and while other processes read the old ones."""

import os
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path


@contextmanager
def atomic_file(path: Path) -> Iterator[Path]:
    """A temporary name beside `path`, with its suffix, for the block to write to.

    After the block the file is flushed to the disk and takes the place of `path`; where anything fails it is removed, which gives its
    room back, and `path` is as it was.
    """
    partial = path.with_name(f".{path.stem}.part{path.suffix}")
    try:
        yield partial
        with partial.open("rb+") as file:
            os.fsync(file.fileno())  # else a loss of power could leave the new name with nothing in it
        replace(partial, path)
    except BaseException:
        with suppress(OSError):
            partial.unlink(missing_ok=True)
        raise
    _flush_folder(path.parent)


def write_atomic(path: Path, data: bytes) -> None:
    """Write a file at once, as `whole` does."""
    with atomic_file(path) as partial:
        partial.write_bytes(data)


def replace(partial: Path, path: Path) -> None:
    """Put a file in the place of another. Windows refuses while somebody reads the old one, so it is tried again for a while."""
    for _ in range(100):
        try:
            return os.replace(partial, path)
        except PermissionError:
            time.sleep(0.002)
    os.replace(partial, path)


def _flush_folder(folder: Path) -> None:
    """So that the new name is on the disk before anything is told that it is. Windows can't, and needs not."""
    if sys.platform == "win32":
        return
    descriptor = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)
