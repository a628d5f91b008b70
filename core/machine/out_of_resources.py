# SPDX-License-Identifier: GPL-3.0-or-later
"""Errors of a full disk or of exhausted memory, translated into one line whichever library raised them."""

from __future__ import annotations

import errno
import os
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from ..errors import Cancelled, InputError, IrgsppError

DISK = {
    errno.ENOSPC: "the disk is full",
    errno.EDQUOT: "the quota of the disk is used up",
    errno.EFBIG: "a file has become larger than this system allows",
    errno.EROFS: "the disk can only be read",
    errno.EIO: "the disk failed to read or write",
}
FULL = 1 << 16  # bytes; a disk with less free space counts as full where a library does not say why it could not write
MEMORY = ("can't allocate memory", "not enough memory", "cannot allocate memory", "bad alloc", "out of memory")
RESUME = "the finished work is saved: continue with --resume"


class OutOfResources(IrgsppError):
    """Disk space or memory ran out, which the user can free; the work done so far is saved."""


@contextmanager
def translate_errors(folder: Path) -> Iterator[None]:
    """Translate errors caused by a full disk or by exhausted memory into OutOfResources within the block.

    Args:
        folder: folder that the block writes to.
    """
    try:
        yield
    except Exception as error:
        found = as_out_of_resources(error, folder)
        if found is None or found is error:
            raise
        raise found from error


def as_out_of_resources(error: BaseException, folder: Path, resumable: bool = True) -> OutOfResources | None:
    """Return the OutOfResources that an error, or one that caused it, amounts to; None for any other error.

    Args:
        error: the error.
        folder: folder that was being written to.
        resumable: the message says that --resume continues the job.
    """
    if isinstance(error, OutOfResources):
        return error
    if isinstance(error, (InputError, Cancelled)):
        return None
    chain = [error]
    while (before := chain[-1].__cause__ or chain[-1].__context__) is not None and before not in chain:
        chain.append(before)
    if any(_is_out_of_memory(e) for e in chain):
        advice = f" or lower data.resolution with --set; {RESUME}" if resumable else ""
        return OutOfResources(f"{folder}: memory ran out; close other programs{advice}")
    what = next((DISK[code] for e in chain if (code := _error_number(e)) in DISK), None) or (_is_full(folder) and DISK[errno.ENOSPC])
    if not what:
        return None
    return OutOfResources(f"{_file_name(chain) or folder}: {what}; free some disk space{f'; {RESUME}' if resumable else ''}")


def _is_out_of_memory(error: BaseException) -> bool:
    known = isinstance(error, MemoryError) or (isinstance(error, OSError) and error.errno == errno.ENOMEM)
    return known or (isinstance(error, (RuntimeError, SystemError)) and any(text in str(error).lower() for text in MEMORY))


def _error_number(error: BaseException) -> int | None:
    """Return the system's number (errno) of an error, found by its text where a library passes on nothing else."""
    if isinstance(error, OSError) and error.errno is not None:
        return error.errno
    return next((code for code in DISK if os.strerror(code) in str(error)), None)


def _file_name(chain: list[BaseException]) -> str | None:
    return next((str(e.filename) for e in chain if isinstance(e, OSError) and e.filename), None)


def _is_full(folder: Path) -> bool:
    try:
        return shutil.disk_usage(folder).free < FULL
    except OSError:
        return False
