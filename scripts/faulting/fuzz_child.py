# SPDX-License-Identifier: GPL-3.0-or-later
"""A process that reads wrong files, started by `fuzz.py` as `python -m faulting.fuzz_child`, with no thread of its own.

On its standard input it is given one line of JSON for each share of files: {"reader": a name, "place": a folder, "seed": 1, "count": 150}.
There it makes right files in `right`, unless they are there, and reads wrong versions of them in `scene`, the same for the same seed. It
writes into `progress`, which must have 8 bytes, the number of the file that it reads, 0 before the first, and into `log` each file that
shows a fault, with the fault as *.fault. It answers each share with one line on its standard output, "done" or what went wrong with the
process itself, and ends when its input does.
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

MEMORY = 512 << 20  # bytes beyond what it has in use once the right files are read
SECONDS = 1.0  # of processor time for one file


class Hang(BaseException):
    """Raised by a timer; no `except Exception` of a reader swallows it."""


@contextmanager
def time_limit(seconds: float) -> Iterator[None]:
    """Raise Hang in the block after so much processor time."""

    def end(*_: object) -> None:
        raise Hang

    before = signal.signal(signal.SIGPROF, end)
    signal.setitimer(signal.ITIMER_PROF, seconds)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_PROF, 0)
        signal.signal(signal.SIGPROF, before)


def fault_of(reader: Reader, folder: Path, file: Path) -> str | None:
    """What is wrong with how a file is read; None where it is read, or refused in one line."""
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
    frames = [f for f in traceback.extract_tb(sys.exc_info()[2]) if "core" in f.filename]
    return f"{Path(frames[-1].filename).name}:{frames[-1].lineno}" if frames else "a library"


@contextmanager
def memory_limit(more: int) -> Iterator[None]:
    """In the block, let this process have at most `more` bytes of address space beyond what it has."""
    before = resource.getrlimit(resource.RLIMIT_AS)
    resource.setrlimit(resource.RLIMIT_AS, (psutil.Process().memory_info().vms + more, before[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_AS, before)


def keep_fault(log: Path, fault: str, name: str, data: bytes) -> None:
    """Note a fault, and the file that shows it."""
    number = sum(1 for _ in log.iterdir())
    (log / f"{number:06}-{name}").write_bytes(data)
    (log / f"{number:06}-{name}.fault").write_text(fault)


def read_share(reader: str, place: str, seed: int, count: int) -> None:
    """Read so many wrong files."""
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
        chosen.read(scene, scene / file)  # right files are read
    with open(root / "progress", "r+b") as file, mmap.mmap(file.fileno(), 8) as progress, memory_limit(MEMORY):
        _read_wrong(chosen, scene, random.Random(seed), count, progress, root / "log")


def _read_wrong(reader: Reader, folder: Path, chance: random.Random, count: int, progress: mmap.mmap, log: Path) -> None:
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
    """Read shares until there are no more."""
    warnings.simplefilter("ignore")
    answers = os.fdopen(os.dup(1), "w")
    silence = os.open(os.devnull, os.O_WRONLY)
    for stream in (1, 2):
        os.dup2(silence, stream)  # libraries of C print
    for line in sys.stdin:
        try:
            read_share(**json.loads(line))
            answer = "done"
        except BaseException:
            answer = " ".join(traceback.format_exc().split())[-600:]
        print(answer, file=answers, flush=True)


if __name__ == "__main__":
    main()
