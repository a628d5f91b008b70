# SPDX-License-Identifier: GPL-3.0-or-later
"""The fuzzer distinguishes crashes, hangs, sleeps, excessive memory and wrong errors from files that are refused."""

import importlib
import sys
from pathlib import Path
from types import SimpleNamespace

import pytest

if sys.platform == "win32":
    pytest.skip("signals and limits of POSIX", allow_module_level=True)

SCRIPTS = Path(__file__).parents[2] / "scripts"
COUNT = 2
# Readers that are at fault for every file but the right one, in a process that has no others.
CHILD = """
import itertools, os, signal, sys, threading, types
from irgspp.core.errors import InputError

def refuse(what):
    raise InputError("a file", what)

WAYS = {
    "refuses": lambda: refuse("is wrong"),
    "errs": lambda: {}["x"],
    "crashes": lambda: os.kill(os.getpid(), signal.SIGSEGV),
    "loops": lambda: all(True for _ in itertools.repeat(0)),
    "is deaf": lambda: sum(itertools.repeat(0)),
    "sleeps": lambda: threading.Event().wait(),
    "devours": lambda: bytearray(1 << 30),
    "gives up": lambda: sys.exit(3),
}

def reader(name, way):
    make = lambda folder: (folder / "a").write_bytes(b"right, as it is long enough")
    read = lambda folder, file: file.read_bytes().startswith(b"right, as it is") or way()
    return types.SimpleNamespace(name=name, files=("a",), make=make, read=read, text=False)

readers = types.ModuleType("faulting.readers")
readers.Reader, readers.READERS = object, [reader(*pair) for pair in WAYS.items()]
sys.modules["faulting.readers"] = readers
from faulting.fuzz_child import main
main()
"""


@pytest.fixture
def fuzz(monkeypatch, tmp_path):
    monkeypatch.syspath_prepend(str(SCRIPTS))
    module = importlib.import_module("faulting.fuzz")
    (tmp_path / "child.py").write_text(CHILD)
    child = module.ReaderProcess()
    monkeypatch.setattr(module, "PROGRAM", (str(tmp_path / "child.py"),))
    monkeypatch.setattr(module, "READER_PROCESS", child)
    monkeypatch.setattr(module, "STUCK", 1.5)
    monkeypatch.setattr(module, "ASLEEP", 6)
    yield module
    child.end()


@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("refuses", None),
        ("errs", "KeyError"),
        ("crashes", "crash, status -11"),
        ("loops", "hang in"),
        ("is deaf", "hang that hears no signal"),
        ("sleeps", "sleeps for ever"),
        ("devours", "memory blow-up"),
    ],
)
def test_faults_are_told(fuzz, tmp_path, name, words):
    done, faults = fuzz.read_mutated(SimpleNamespace(name=name, files=("a",)), COUNT, 5, tmp_path / "kept")
    assert done == COUNT
    if words is None:
        assert not faults
        return
    assert faults and all(words in fault for fault in faults)
    kept = [path for path in (tmp_path / "kept").rglob("*-a") if not path.read_bytes().startswith(b"right, as it is")]
    assert len(kept) == faults.total()


def test_process_that_fails_by_itself_is_an_error(fuzz):
    with pytest.raises(RuntimeError, match="SystemExit: 3"):
        fuzz.read_mutated(SimpleNamespace(name="gives up", files=("a",)), COUNT, 5)
    with pytest.raises(RuntimeError, match="StopIteration"):
        fuzz.read_mutated(SimpleNamespace(name="is not there", files=("a",)), COUNT, 5)


def test_same_seed_gives_the_same_files(fuzz, tmp_path):
    reader = SimpleNamespace(name="errs", files=("a",))
    for name, seed in (("one", 5), ("two", 5), ("other", 6)):
        fuzz.read_mutated(reader, 40, seed, tmp_path / name)
    one, two, other = ([p.read_bytes() for p in sorted((tmp_path / name).rglob("*-a"))] for name in ("one", "two", "other"))
    assert len(one) > 10 and one == two != other
