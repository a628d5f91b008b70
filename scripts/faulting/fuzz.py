# SPDX-License-Identifier: GPL-3.0-or-later
"""Every reader against many wrong files: an InputError in one line or a result, within a second and half a gigabyte."""

# pyright: reportMissingImports=false
# (`irgspp` is the folder above, known to pyright under no name)

from __future__ import annotations

import mmap
import os
import random
import resource
import shutil
import signal
import struct
import sys
import tempfile
import time
import traceback
import warnings
from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import psutil
from irgspp.core.errors import InputError
from stresses.case import Measured

from .cases import case_of
from .mutate import mutated
from .readers import READERS, Reader

case = case_of("fuzz")
MEMORY = 512 << 20
SECONDS = 1.0  # of processor time for one file
STUCK = 3.0  # of processor time, after which even code that hears no signal is ended
ASLEEP = 60.0  # seconds of the clock in which it may do nothing: one that waits for a lock takes no processor time
SHARE = 2000  # files that a process reads before another takes its place
EVENLY = 1_000_003  # a prime: no two processes draw the same
SHOWN = 5  # failures of a kind that are told


class Hang(BaseException):
    """Raised by a timer; no `except Exception` of a reader swallows it."""


@contextmanager
def within(seconds: float) -> Iterator[None]:
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
        with within(SECONDS):
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


def _write(file: Path, data: bytes) -> None:
    file.parent.mkdir(parents=True, exist_ok=True)
    file.write_bytes(data)


def _child(reader: Reader, folder: Path, right: list[bytes], seed: int, count: int, note: mmap.mmap, log: Path) -> None:
    """Read `count` wrong files; how many is in `note`, what went wrong goes to the log."""
    warnings.simplefilter("ignore")
    silence = os.open(os.devnull, os.O_WRONLY)
    for stream in (1, 2):
        os.dup2(silence, stream)  # libraries of C print
    chance = random.Random(seed)
    limit = psutil.Process().memory_info().vms + MEMORY
    resource.setrlimit(resource.RLIMIT_AS, (limit, limit))
    for done in range(count):
        which = chance.randrange(len(reader.files))
        data = mutated(right[which], chance, right, reader.text)
        file = folder / reader.files[which]
        _write(file, data)
        note[:8] = struct.pack("<Q", done)
        fault = fault_of(reader, folder, file)
        if fault is not None:
            _keep(log, fault, file.name, data)
        _write(file, right[which])
    note[:8] = struct.pack("<Q", count)


def _keep(log: Path, fault: str, name: str, data: bytes) -> None:
    number = sum(1 for _ in log.iterdir())
    (log / f"{number:06}-{name}").write_bytes(data)
    (log / f"{number:06}-{name}.fault").write_text(fault)


def hammer(reader: Reader, cases: int, seed: int, keep: Path | None = None) -> tuple[int, Counter[str]]:
    """How many wrong files were read, and the faults that showed, with how often each. keep: where files that show one are copied."""
    faults: Counter[str] = Counter()
    place = "/dev/shm" if os.path.isdir("/dev/shm") else None
    with tempfile.TemporaryDirectory(prefix="irgspp-faults-", dir=place) as name:
        root = Path(name)
        folder, log = root / "scene", root / "log"
        folder.mkdir()
        log.mkdir()
        reader.make(folder)
        right = [(folder / file).read_bytes() for file in reader.files]
        for file in reader.files:
            reader.read(folder, folder / file)  # right files are read
        done = 0
        while done < cases:
            count, ended = _generation(reader, folder, right, seed + EVENLY * done, min(SHARE, cases - done), log)
            done += count
            if ended is not None:
                faults[ended] += 1
        for fault in log.glob("*.fault"):
            faults[fault.read_text()] += 1
        if keep is not None and faults:
            shutil.copytree(log, keep / reader.name.replace(" ", "_"), dirs_exist_ok=True)
    return done, faults


def _generation(reader: Reader, folder: Path, right: list[bytes], seed: int, count: int, log: Path) -> tuple[int, str | None]:
    """One process's share: how many files it has read, and how it ended where that was not well."""
    note = mmap.mmap(-1, 8)
    child = os.fork()
    if child == 0:
        try:
            _child(reader, folder, right, seed, count, note, log)
        except BaseException:
            (log / "harness.fault").write_text("harness: " + traceback.format_exc()[-600:])
        finally:
            os._exit(0)
    status, stuck = _watched(child, note)
    (read,) = struct.unpack("<Q", note[:8])
    if read >= count:
        return count, None
    for file, data in zip(reader.files, right, strict=True):
        broken = (folder / file).read_bytes() if (folder / file).is_file() else b""
        if broken != data:
            _keep(log, "hang that hears no signal" if stuck else f"crash by signal {os.WTERMSIG(status)}", Path(file).name, broken)
            _write(folder / file, data)
    return read + 1, None if os.WIFSIGNALED(status) else "the harness ended early"


def _watched(child: int, note: mmap.mmap) -> tuple[int, bool]:
    """Wait for a process; its status, and whether it was ended because it made no progress for too much processor time."""
    before, spent, since = b"", 0.0, time.monotonic()
    while True:
        ended, status = os.waitpid(child, os.WNOHANG)
        if ended:
            return status, False
        times = psutil.Process(child).cpu_times()
        now = times.user + times.system
        if note[:8] != before:
            before, spent, since = note[:8], now, time.monotonic()
        elif now - spent > STUCK or time.monotonic() - since > ASLEEP:
            os.kill(child, signal.SIGKILL)
            return os.waitpid(child, 0)[1], True
        time.sleep(0.05)


def _case(reader: Reader, cases: int, quick: bool) -> None:
    text = f"{cases:,} wrong files: each is read or refused in one line, within {SECONDS:g} s and {MEMORY >> 20} MB, without a crash."

    @case(f"{reader.name}, {cases:,} files", text, quick)
    def run(measured: Measured) -> None:
        keep = os.environ.get("IRGSPP_KEEP_FAULTS")
        done, faults = hammer(reader, cases, 1 if quick else 2, Path(keep) if keep else None)
        measured.at_least("files", done, cases)
        for fault, times in faults.most_common(SHOWN):
            measured.holds(f"{fault} ({times} times)", False)


for _reader in READERS:
    _case(_reader, 150, True)
    _case(_reader, 100_000, False)
