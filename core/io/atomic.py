# SPDX-License-Identifier: GPL-3.0-or-later
"""Atomic writing of files: a reader finds the old or the new file complete, even after a crash or a loss of power.

Folders are replaced whole too, though not in one step.
"""

import os
import shutil
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path


@contextmanager
def atomic_file(path: Path) -> Iterator[Path]:
    """Yield a temporary path for the block to write to, in the folder of `path` and with its suffix.

    After the block, the temporary file is flushed to the disk and replaces `path`. If anything fails, it is removed, which frees its disk
    space, and `path` is unchanged.

    Args:
        path: the file to write.
    """
    partial = path.with_name(f".{path.stem}.part{path.suffix}")
    try:
        yield partial
        with partial.open("rb+") as file:
            os.fsync(file.fileno())  # otherwise a loss of power could leave an empty file under the new name
        replace(partial, path)
    except BaseException:
        with suppress(OSError):
            partial.unlink(missing_ok=True)
        raise
    _flush_folder(path.parent)


@contextmanager
def replaced_folder(folder: Path) -> Iterator[Path]:
    """Yield a new, empty folder beside `folder` for the block to fill; after the block it replaces `folder` and all that was in it.

    If the block fails, the new folder is removed, and `folder` is unchanged. A crash while the old folder is removed leaves a part of it or
    none, never a part of the new one.

    Args:
        folder: the folder to write, which need not exist.
    """
    partial = folder.with_name(f".{folder.name}.part")
    shutil.rmtree(partial, ignore_errors=True)
    partial.mkdir(parents=True)
    try:
        yield partial
    except BaseException:
        shutil.rmtree(partial, ignore_errors=True)
        raise
    shutil.rmtree(folder, ignore_errors=True)
    os.replace(partial, folder)


def write_atomic(path: Path, data: bytes) -> None:
    """Write a file atomically (see `atomic_file`).

    Args:
        path: the file to write.
        data: its content.
    """
    with atomic_file(path) as partial:
        partial.write_bytes(data)


def replace(partial: Path, path: Path) -> None:
    """Replace a file by another, with retries for up to 0.2 seconds, since Windows refuses while another process reads the old one.

    Args:
        partial: the new file, which is renamed.
        path: the file that it replaces.

    Raises:
        PermissionError: if the last attempt fails too.
    """
    for _ in range(100):
        try:
            return os.replace(partial, path)
        except PermissionError:
            time.sleep(0.002)
    os.replace(partial, path)


def _flush_folder(folder: Path) -> None:
    """Flush a folder's entries, so that a renamed file survives a loss of power; Windows can't, and does not need to."""
    if sys.platform == "win32":
        return
    descriptor = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)
