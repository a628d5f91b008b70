# SPDX-License-Identifier: GPL-3.0-or-later
"""Fuzzer of all file readers: each broken file gives an InputError in one line or a result, within a second and half a gigabyte."""

from __future__ import annotations

import atexit
import json
import os
import select
import shutil
import struct
import subprocess
import sys
import tempfile
from collections import Counter
from pathlib import Path

import psutil
from stresses.case import Measured

from .cases import case_of
from .fuzz_child import MEMORY, SECONDS, keep_fault
from .readers import READERS, Reader

case = case_of("fuzz")
SCRIPTS = Path(__file__).resolve().parents[1]
PROGRAM = ("-m", "faulting.fuzz_child")
ONE_THREAD = {f"{library}_NUM_THREADS": "1" for library in ("OMP", "OPENBLAS", "MKL", "NUMBA")}
STUCK = 3.0  # seconds of processor time for one file, after which even code that ignores signals is ended
READY = 300.0  # seconds of processor time until the first file
LOOK = 0.25  # seconds between two checks of a process
ASLEEP = 240  # successive checks that find a process asleep over one file: it waits for ever
BATCH = 10_000  # files that a process reads before another replaces it
SEED_STEP = 1_000_003  # a prime, so that no two batches have the same seed
SHOWN = 5  # kinds of faults that a case reports


class ReaderProcess:
    """Process that reads files: started when it is needed, and again once it has died or read BATCH files."""

    def __init__(self) -> None:
        self._process: subprocess.Popen[str] | None = None
        self._read = 0
        atexit.register(self.end)

    def read(self, reader: str, place: Path, seed: int, count: int) -> tuple[int, str | None]:
        """Read a batch of broken files.

        Args:
            reader: name of the reader.
            place: folder of the files.
            seed: seed of the broken files.
            count: number of files.

        Returns:
            How many files were read, and how the process ended where it did.

        Raises:
            RuntimeError: where the process fails by itself.
        """
        if self._read + count > BATCH:
            self.end()
        self._read += count
        process = self._process = self._process or _started()
        assert process.stdin and process.stdout
        (place / "progress").write_bytes(bytes(8))
        print(json.dumps({"reader": reader, "place": str(place), "seed": seed, "count": count}), file=process.stdin, flush=True)
        stuck = _wait_for_answer(process, place / "progress")
        answer = process.stdout.readline().strip()
        if answer == "done":
            return count, None
        self.end()
        number = _number(place / "progress")
        if answer or not number:
            raise RuntimeError(f"the reading process failed: {answer or f'status {process.returncode}'}")
        return number, stuck or f"crash, status {process.returncode}"

    def end(self) -> None:
        """End the process."""
        process, self._process, self._read = self._process, None, 0
        if process is not None:
            assert process.stdin and process.stdout
            process.stdin.close()  # ends a process that waits for more
            process.wait()
            process.stdout.close()


def _started() -> subprocess.Popen[str]:
    """Start a process."""
    paths = os.pathsep.join([str(SCRIPTS), *filter(None, [os.environ.get("PYTHONPATH")])])
    environment = {**os.environ, **ONE_THREAD, "PYTHONPATH": paths}
    return subprocess.Popen([sys.executable, *PROGRAM], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True, env=environment)


def _number(progress: Path) -> int:
    """Return the number of the file that is being read, 0 before the first."""
    return struct.unpack("<Q", progress.read_bytes())[0]


def _wait_for_answer(process: subprocess.Popen[str], progress: Path) -> str | None:
    """Wait until a process has answered or ended; return why it was killed where it made no progress."""
    watched, before, since, asleep = psutil.Process(process.pid), 0, None, 0
    assert process.stdout
    while not select.select([process.stdout], [], [], LOOK)[0]:
        times, number = watched.cpu_times(), _number(progress)
        spent = times.user + times.system
        if number != before or since is None:
            before, since, asleep = number, spent, 0
        asleep = asleep + 1 if number and watched.status() == psutil.STATUS_SLEEPING else 0
        if spent - since > (STUCK if number else READY) or asleep > ASLEEP:
            process.kill()
            return "sleeps for ever" if asleep > ASLEEP else "hang that hears no signal"
    return None


READER_PROCESS = ReaderProcess()


def read_mutated(reader: Reader, cases: int, seed: int, kept: Path | None = None) -> tuple[int, Counter[str]]:
    """Read broken files and count the faults.

    Args:
        reader: reader to test.
        cases: number of files.
        seed: seed of the broken files.
        kept: folder for copies of the files that show a fault.

    Returns:
        How many files were read, and the faults with how often each occurred.
    """
    with tempfile.TemporaryDirectory(prefix="irgspp-faults-", dir="/dev/shm" if os.path.isdir("/dev/shm") else None) as name:
        place, done = Path(name), 0
        log = place / "log"
        log.mkdir()
        while done < cases:
            count, ended = READER_PROCESS.read(reader.name, place, seed + SEED_STEP * done, min(BATCH, cases - done))
            done += count
            if ended is not None:
                _keep_broken_files(reader, place, ended)
        faults = Counter(fault.read_text() for fault in log.glob("*.fault"))
        if kept is not None and faults:
            shutil.copytree(log, kept / reader.name.replace(" ", "_"), dirs_exist_ok=True)
    return done, faults


def _keep_broken_files(reader: Reader, place: Path, ended: str) -> None:
    """Record the file over which a process ended."""
    broken = [f for f in reader.files if (place / "scene" / f).read_bytes() != (place / "right" / f).read_bytes()]
    for file in broken or reader.files[:1]:  # the file may be unchanged: a mutation can give a valid file
        keep_fault(place / "log", ended, Path(file).name, (place / "scene" / file).read_bytes())


def _case(reader: Reader, cases: int, quick: bool) -> None:
    """Register a case of a reader."""
    text = f"{cases:,} broken files: each is read or refused in one line, within {SECONDS:g} s and {MEMORY >> 20} MB, without a crash."

    @case(f"{reader.name}, {cases:,} files", text, quick)
    def run(measured: Measured) -> None:
        """Read the broken files and check that there is no fault."""
        kept = os.environ.get("IRGSPP_KEEP_FAULTS")
        done, faults = read_mutated(reader, cases, 1 if quick else 2, Path(kept) if kept else None)
        measured.at_least("files", done, cases)
        for fault, times in faults.most_common(SHOWN):
            measured.holds(f"{fault} ({times} times)", False)


for _reader in READERS:
    _case(_reader, 150, True)
    _case(_reader, 100_000, False)
