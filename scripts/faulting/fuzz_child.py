# SPDX-License-Identifier: GPL-3.0-or-later
"""Process that reads broken files, started by `fuzz.py` as `python -m faulting.fuzz_child`, with a single thread.

Its standard input has one line of JSON for each batch of files: {"reader": a name, "place": a folder, "seed": 1, "count": 150}. In that
folder it makes valid files in `right`, unless they exist, and reads broken versions of them in `scene`, the same for the same seed. It
writes into `progress`, which must have 8 bytes, the number of the file that it reads, 0 before the first, and into `log` each file that
shows a fault, with the fault as *.fault. It answers each batch with one line on its standard output, "done" or what went wrong with the
process itself, and ends with its input.
"""

from __future__ import annotations

import json
import mmap
import os
import random
import resource
import shutil
import signal
import struct
import sys
import traceback
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import psutil
from irgspp.core.errors import InputError

from .mutate import mutated
from .readers import READERS, Reader

MEMORY = 512 << 20  # bytes beyond those in use once the valid files are read
SECONDS = 1.0  # of processor time for one file


class Hang(BaseException):
    """Exception of a timer; no `except Exception` of a reader catches it."""


@contextmanager
def time_limit(seconds: float) -> Iterator[None]:
    """Raise Hang in the block after some processor time in seconds."""

    def end(*_: object) -> None:
        """Raise Hang."""
        raise Hang

    before = signal.signal(signal.SIGPROF, end)
    signal.setitimer(signal.ITIMER_PROF, seconds)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_PROF, 0)
        signal.signal(signal.SIGPROF, before)


def fault_of(reader: Reader, folder: Path, file: Path) -> str | None:
    """Return the fault of a reader on a file; None where it reads the file, or refuses it in one line.

    Args:
        reader: reader to test.
        folder: folder of the files.
        file: broken file.
    """
    try:
        with time_limit(SECONDS):
            reader.read(folder, file)
    except InputError as error:
        if "\n" in str(error) or len(str(error)) > 4500:
            return f"a message that is no line: {str(error)[:80]!r}"
        return "memory blow-up" if any(isinstance(e, MemoryError) for e in (error.__cause__, error.__context__)) else None
    except Hang:
        return f"hang in {traceback.extract_tb(sys.exc_info()[2])[-2].line}"
    except MemoryError:
        return f"memory blow-up at {_place()}"
    except Exception as error:
        return f"{type(error).__name__} at {_place()}: {' '.join(str(error).split())[:80]}"
    return None


def _place() -> str:
    """Return the file and line of the engine that raised the present exception."""
    frames = [f for f in traceback.extract_tb(sys.exc_info()[2]) if "core" in f.filename]
    return f"{Path(frames[-1].filename).name}:{frames[-1].lineno}" if frames else "a library"


@contextmanager
def memory_limit(more: int) -> Iterator[None]:
    """Limit the process's address space in the block to some bytes beyond its present size."""
    before = resource.getrlimit(resource.RLIMIT_AS)
    resource.setrlimit(resource.RLIMIT_AS, (psutil.Process().memory_info().vms + more, before[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_AS, before)


def keep_fault(log: Path, fault: str, name: str, data: bytes) -> None:
    """Write a fault, and the file that shows it, into the log.

    Args:
        log: folder of the log.
        fault: description of the fault.
        name: name of the file.
        data: content of the file.
    """
    number = sum(1 for _ in log.iterdir())
    (log / f"{number:06}-{name}").write_bytes(data)
    (log / f"{number:06}-{name}.fault").write_text(fault)


def read_batch(reader: str, place: str, seed: int, count: int) -> None:
    """Read a batch of broken files.

    Args:
        reader: name of the reader.
        place: folder of the files.
        seed: seed of the broken files.
        count: number of files.
    """
    chosen = next(one for one in READERS if one.name == reader)
    root = Path(place)
    right, scene = root / "right", root / "scene"
    if not right.is_dir():
        (root / "fresh").mkdir()
        chosen.make(root / "fresh")
        (root / "fresh").rename(right)
    shutil.rmtree(scene, ignore_errors=True)
    shutil.copytree(right, scene)
    for file in chosen.files:
        chosen.read(scene, scene / file)  # valid files must be read without an error
    with open(root / "progress", "r+b") as file, mmap.mmap(file.fileno(), 8) as progress, memory_limit(MEMORY):
        _read_broken(chosen, scene, random.Random(seed), count, progress, root / "log")


def _read_broken(reader: Reader, folder: Path, chance: random.Random, count: int, progress: mmap.mmap, log: Path) -> None:
    """Read broken files, one at a time next to valid ones."""
    files = [folder / file for file in reader.files]
    right = [file.read_bytes() for file in files]
    for number in range(1, count + 1):
        which = chance.randrange(len(files))
        data = mutated(right[which], chance, right, reader.text)
        files[which].write_bytes(data)
        progress[:8] = struct.pack("<Q", number)
        fault = fault_of(reader, folder, files[which])
        if fault is not None:
            keep_fault(log, fault, files[which].name, data)
        files[which].write_bytes(right[which])


def main() -> None:
    """Read batches until the input ends."""
    warnings.simplefilter("ignore")
    answers = os.fdopen(os.dup(1), "w")
    silence = os.open(os.devnull, os.O_WRONLY)
    for stream in (1, 2):
        os.dup2(silence, stream)  # C libraries print
    for line in sys.stdin:
        try:
            read_batch(**json.loads(line))
            answer = "done"
        except BaseException:
            answer = " ".join(traceback.format_exc().split())[-600:]
        print(answer, file=answers, flush=True)


if __name__ == "__main__":
    main()
