# SPDX-License-Identifier: GPL-3.0-or-later
"""Full, read-only and limited disks: one clear message, the last good state kept, and the job continues once there is space."""

from __future__ import annotations

import resource
import shutil
import tempfile
from collections.abc import Callable
from contextlib import AbstractContextManager
from pathlib import Path

from irgspp.core import pipeline
from irgspp.core.run_folder import read_run
from stresses.case import Measured

from .cases import case_of
from .kill import unreadable
from .mounts import LEFT_OUT, can_mount, mounted, remount
from .tiny import JobStarter, KillPoint, differing_files, reference_run, user_lines, work, write_dataset

case = case_of("disk")
PLENTY = 64 << 20  # bytes


def small_disk(folder: Path, size: int) -> AbstractContextManager[Path]:
    """Mount a file system in memory.

    Args:
        folder: folder in which the disk is mounted.
        size: bytes.

    Raises:
        OSError: where this user may not mount one.
    """
    return mounted("-t", "tmpfs", "-o", f"size={size}", "tmpfs", place=folder / "disk")


def filled(place: Path, left: int) -> Path:
    """Write a file that fills a disk.

    Args:
        place: folder on the disk.
        left: free bytes that are left.

    Returns:
        The file.
    """
    filler = place / "filler"
    with filler.open("wb") as file:
        for _ in range(max(0, shutil.disk_usage(place).free - left) // 4096):
            file.write(bytes(4096))
    return filler


def work_on_full_disk(dataset: str, run: str, resume: bool, left: int) -> None:
    """Run the job on a disk that is filled once the job has begun.

    Args:
        dataset: folder of the photographs.
        run: run folder.
        resume: True to resume the run.
        left: free bytes that are left.
    """
    _work_with_fault(dataset, run, resume, lambda job: filled(Path(run).parent, left))


def work_with_file_limit(dataset: str, run: str, resume: bool, size: int) -> None:
    """Run the job with a limit on the size of files once it has begun.

    Args:
        dataset: folder of the photographs.
        run: run folder.
        resume: True to resume the run.
        size: most bytes of a file.
    """
    _work_with_fault(dataset, run, resume, lambda job: resource.setrlimit(resource.RLIMIT_FSIZE, (size, size)))


def work_on_read_only_disk(dataset: str, run: str, resume: bool) -> None:
    """Run the job on a disk that becomes read-only once the job has begun.

    Args:
        dataset: folder of the photographs.
        run: run folder.
        resume: True to resume the run.
    """

    def make_read_only(job: pipeline.Job) -> None:
        """Make the disk read-only."""
        job.folder.close()  # the lock is open for writing, and a disk with such a file can't be made read-only
        remount(Path(run).parent, "ro")

    _work_with_fault(dataset, run, resume, make_read_only)


def _work_with_fault(dataset: str, run: str, resume: bool, fault: Callable[[pipeline.Job], object] = lambda job: None) -> None:
    """Run the job with a fault once it has begun; its messages go to a disk with space."""
    begin = pipeline.Job.run

    def run_with_fault(job: pipeline.Job) -> None:
        """Apply the fault and run the job."""
        fault(job)
        begin(job)

    pipeline.Job.run = run_with_fault
    work(dataset, run, resume, KillPoint(), output=str(Path(run).parent.parent / "said.txt"))


def check_message(measured: Measured, folder: Path, status: int, expected: int, words: str, where: str) -> None:
    """Check the exit status, and that the user gets one line with some words and no traceback.

    Args:
        measured: result of the case.
        folder: folder of the job's messages.
        status: exit status.
        expected: expected exit status.
        words: words of the line.
        where: name of the fault.
    """
    lines = user_lines(folder / "said.txt")
    measured.holds(f"{where}: exit status {expected}, not {status}", status == expected)
    measured.holds(f"{where}: one line with {words!r}, not {lines}", len(lines) == 1 and words in lines[0])


def check_faults(measured: Measured, size: int, faults: list[tuple]) -> None:
    """Check each fault and the next start on a small disk.

    Args:
        measured: result of the case.
        size: bytes of the disk.
        faults: (name, function, further arguments, words of the message, function that ends the fault) of each.
    """
    if not can_mount():
        measured.note(LEFT_OUT)
        return
    starter = JobStarter()
    with tempfile.TemporaryDirectory(prefix="irgspp-faults-") as name, small_disk(Path(name), size) as disk:
        folder = Path(name)
        data, reference, _ = reference_run()
        for label, function, more, words, mend in faults:
            run = disk / "run"
            check_message(measured, folder, starter.run(function, str(data), str(run), False, *more), 1, words, label)
            mend(disk)
            for what in unreadable(run):
                measured.holds(f"{label}: {what} is readable", False)
            status = starter.run(work, str(data), str(run), True, KillPoint())
            measured.holds(f"{label}: continues with space, not status {status}: {user_lines(Path(f'{run}.txt'))}", status == 0)
            different = differing_files(run, reference)
            measured.holds(
                f"{label}: the same bits, not others in {', '.join(different)}", not different and read_run(run)["status"] == "done"
            )
            shutil.rmtree(run)
        measured.note(f"{len(faults)} faults")


def free(disk: Path) -> None:
    """Make space again."""
    (disk / "filler").unlink()


@case(
    "full while the job works",
    """A disk in memory that runs full at different moments: exit status 1, one line that says so, files under their final names can be
    read, and the next start, with space, ends with the same bits as an undisturbed run.""",
)
def full(measured: Measured) -> None:
    """Check a disk that runs full with 700 kB left."""
    check_faults(measured, PLENTY, [("700 kB left", work_on_full_disk, (700_000,), "the disk is full", free)])


@case("full at 11 moments", "The same with from 0 bytes to 2 MB left.", quick=False)
def full_often(measured: Measured) -> None:
    """Check a disk that runs full with 11 amounts of free space."""
    sizes = (0, 8192, 40_000, 120_000, 250_000, 350_000, 500_000, 700_000, 1_000_000, 1_500_000, 2_000_000)
    check_faults(measured, PLENTY, [(f"{left} bytes left", work_on_full_disk, (left,), "the disk is full", free) for left in sizes])


@case("read-only while the job works", "A disk that becomes read-only: the same.", quick=False)
def read_only(measured: Measured) -> None:
    """Check a disk that becomes read-only."""
    check_faults(measured, PLENTY, [("read-only", work_on_read_only_disk, (), "can only be read", lambda disk: remount(disk, "rw"))])


@case(
    "limit of a file's size",
    "The largest file that the user may write is met (ulimit -f, as quotas of some systems): the same.",
    quick=False,
)
def quota(measured: Measured) -> None:
    """Check limits on the size of a file."""
    sizes = (100_000, 300_000, 600_000)
    check_faults(measured, PLENTY, [(f"{size} bytes", work_with_file_limit, (size,), "larger than", lambda disk: None) for size in sizes])


@case(
    "not started without space",
    """On a disk of 1 MB, full or read-only, no job begins and no file is left: exit status 2, and a line with the space that is needed
    and free.""",
)
def no_room(measured: Measured) -> None:
    """Check that a job on a full or read-only disk does not begin."""
    if not can_mount():
        measured.note(LEFT_OUT)
        return
    starter = JobStarter()
    with tempfile.TemporaryDirectory(prefix="irgspp-faults-") as name, small_disk(Path(name), 1 << 20) as disk:
        folder = Path(name)
        data, run = write_dataset(folder / "photographs"), disk / "run"
        check_message(measured, folder, starter.run(_work_with_fault, str(data), str(run), False), 2, "the job needs about", "little space")
        remount(disk, "ro")
        check_message(measured, folder, starter.run(_work_with_fault, str(data), str(run), False), 2, "is not writable", "read-only")
        remount(disk, "rw")
        measured.holds("nothing is left behind", not list(disk.iterdir()))
        measured.note("one line each")
