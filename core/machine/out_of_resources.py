# SPDX-License-Identifier: GPL-3.0-or-later
"""What the machine ran out of, disk or memory, told in one line whichever library met it."""

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
    errno.EIO: "the disk fails",
}
FULL = 1 << 16  # bytes; libraries that don't say why they can't write met a disk with less than that
MEMORY = ("can't allocate memory", "not enough memory", "cannot allocate memory", "bad alloc", "out of memory")
GO_ON = "what was finished is kept: go on with --resume"


class OutOfResources(IrgsppError):
    """The machine lacks something that can be made free; what is done so far is kept."""


@contextmanager
def translate_errors(folder: Path) -> Iterator[None]:
    """Within the block, turn errors that a full disk or memory is behind into a Shortage. folder: where the block writes."""
    try:
        yield
    except Exception as error:
        found = as_out_of_resources(error, folder)
        if found is None or found is error:
            raise
        raise found from error


def as_out_of_resources(error: BaseException, folder: Path, resumable: bool = True) -> OutOfResources | None:
    """What was lacking where an error came from that; None where it came from something else. resumable: --resume goes on."""
    if isinstance(error, OutOfResources):
        return error
    if isinstance(error, (InputError, Cancelled)):
        return None
    chain = [error]
    while (before := chain[-1].__cause__ or chain[-1].__context__) is not None and before not in chain:
        chain.append(before)
    if any(_of_memory(e) for e in chain):
        less = f" or give --set data.resolution=... less; {GO_ON}" if resumable else ""
        return OutOfResources(f"{folder}: memory ran out; close other programs{less}")
    what = next((DISK[code] for e in chain if (code := _code(e)) in DISK), None) or (_is_full(folder) and DISK[errno.ENOSPC])
    return OutOfResources(f"{_place(chain) or folder}: {what}; free some room{f', and {GO_ON}' if resumable else ''}") if what else None


def _of_memory(error: BaseException) -> bool:
    known = isinstance(error, MemoryError) or (isinstance(error, OSError) and error.errno == errno.ENOMEM)
    return known or (isinstance(error, (RuntimeError, SystemError)) and any(text in str(error).lower() for text in MEMORY))


def _code(error: BaseException) -> int | None:
    """The system's number of an error, of libraries that only pass its text on as well."""
    if isinstance(error, OSError) and error.errno is not None:
        return error.errno
    return next((code for code in DISK if os.strerror(code) in str(error)), None)


def _place(chain: list[BaseException]) -> str | None:
    return next((str(e.filename) for e in chain if isinstance(e, OSError) and e.filename), None)


def _is_full(folder: Path) -> bool:
    try:
        return shutil.disk_usage(folder).free < FULL
    except OSError:
        return False
