# SPDX-License-Identifier: GPL-3.0-or-later
"""Check that no other job or program writes into a job's folder."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

from ...core.errors import InputError
from ...core.io.file_lock import FileLock
from .job import Job

WRITERS = ("reconstruct", "demo", "bake", "capture")  # kinds of jobs that write into their folder: at most one per folder


def check_free(folder: Path, jobs: Iterable[Job]) -> None:
    """Check that nothing else writes into a folder.

    Args:
        folder: folder that a job is to write into.
        jobs: all known jobs.

    Raises:
        InputError: if another job, of this Blender or any other program, writes into the folder, or its lock can't be opened.
    """
    for job in jobs:
        if not job.finished and job.kind in WRITERS and job.folder.resolve() == folder.resolve():
            fix = "wait for it, cancel it, or choose another folder"
            raise InputError(folder, f"the job {job.title} is {job.state} for this folder", fix)
    if (folder / ".lock").exists():
        try:
            FileLock(folder / ".lock").release()
        except BlockingIOError:
            raise InputError(folder, "is in use by another Blender or program", "wait for it or choose another folder") from None
        except OSError as error:
            raise InputError(folder, f"can't be written ({error.strerror})") from error
