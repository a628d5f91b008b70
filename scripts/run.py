# SPDX-License-Identifier: GPL-3.0-or-later
"""Set up the tool in .venv, run the demo or the tests, build the documentation.

    python3 scripts/run.py setup|demo|test|docs [arguments passed on]

Only the standard library is used, and nothing newer than Python 3.6 up to the version check, so that an old Python gets a clear line.
"""

import hashlib
import os
import shutil
import subprocess
import sys
import time
from contextlib import contextmanager
from pathlib import Path

if os.name == "nt":
    import msvcrt
else:
    import fcntl

ROOT = Path(__file__).resolve().parent.parent
VENV = ROOT / ".venv"
LOCK = ROOT / "requirements.lock"
STAMP = VENV / "irgspp-setup.sha256"  # digest of what is installed; written last
UNFINISHED = VENV / "irgspp-setup-unfinished"  # there while an installation runs
LOCKED = ROOT / "build" / "setup.lock"  # held by the set-up that runs; the system releases it when that ends
PYTHON = VENV / ("Scripts/python.exe" if os.name == "nt" else "bin/python")
REQUIRED = (3, 11)
COMMANDS = ("setup", "demo", "test", "docs")
DOCS_LOCK = ROOT / "docs" / "requirements.lock"


def fail(reason: str) -> None:
    """Print a line and end with exit status 2."""
    print("run.py: " + reason, file=sys.stderr)
    raise SystemExit(2)


def say(text: str) -> None:
    """Print a progress line."""
    print("run.py: " + text, file=sys.stderr, flush=True)


def check_python() -> None:
    """End with a message where this Python is not version 3.11."""
    if sys.version_info[:2] != REQUIRED:
        version = ".".join(map(str, sys.version_info[:2]))
        fail(f"needs Python 3.11 (Blender 4.5's bpy has no wheel for another), this is {version}; start it with python3.11")


def digest() -> str:
    """Return a digest of what has to be installed: the pins and the package's own description."""
    return hashlib.sha256(LOCK.read_bytes() + (ROOT / "pyproject.toml").read_bytes() + str(ROOT).encode()).hexdigest()


def environment() -> dict:
    """Return the child's environment: threads of torch sleep between kernels and leave the cores to numba's kernels."""
    return {"OMP_WAIT_POLICY": "PASSIVE", "PIP_DISABLE_PIP_VERSION_CHECK": "1", "NO_MKDOCS_2_WARNING": "1", **os.environ}


def call(*command: object) -> int:
    """Run a command on this terminal and return its exit status, 130 after Ctrl-C."""
    process = subprocess.Popen([str(part) for part in command], cwd=str(ROOT), env=environment())
    interrupted = False
    while True:
        try:
            status = process.wait()
            return 130 if interrupted and status else status
        except KeyboardInterrupt:
            interrupted = True  # the terminal sent Ctrl-C to the child as well, which ends by itself


def install(*what: object, reason: str) -> None:
    """Install by the environment's pip, or end with a message.

    Args:
        *what: arguments of `pip install`.
        reason: message where pip fails.
    """
    status = call(PYTHON, "-m", "pip", "install", *what)
    if status == 130:
        say("stopped; the next start repeats the set-up")
        raise SystemExit(130)
    if status:
        fail(reason)


def works(python: Path) -> bool:
    """Return True where a virtual environment's Python starts, has pip, and is of the right version."""
    probe = f"import pip, sys; sys.exit(sys.version_info[:2] != {REQUIRED})"
    try:
        return subprocess.run([str(python), "-c", probe], stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL).returncode == 0
    except OSError:
        return False


def make_venv() -> None:
    """Make .venv, also in place of one that is unfinished or whose Python no longer starts."""
    if VENV.exists() and not UNFINISHED.exists() and works(PYTHON):
        return
    say("making it again: .venv is unfinished or broken" if VENV.exists() else "making .venv")
    if call(sys.executable, "-m", "venv", "--clear", VENV) != 0:
        fail("could not make .venv (on Debian and Ubuntu: install the package python3.11-venv)")


def try_lock(file) -> bool:
    """Lock an open file for this process and return True, or False where another one has locked it."""
    try:
        if os.name == "nt":
            msvcrt.locking(file.fileno(), msvcrt.LK_NBLCK, 1)
        else:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except (BlockingIOError, PermissionError):
        return False
    except OSError:
        say("this file system has no locks: start one set-up at a time")
    return True


@contextmanager
def alone():
    """Wait until no other set-up of this folder runs, and keep others waiting."""
    try:
        LOCKED.parent.mkdir(parents=True, exist_ok=True)
        LOCKED.touch()
    except OSError as error:
        fail("could not write " + str(LOCKED) + " (" + str(error.strerror) + "); make this folder writable")
    with open(str(LOCKED), "w") as file:
        if not try_lock(file):
            say("waiting for another set-up of this folder")
            try:
                while not try_lock(file):
                    time.sleep(0.2)
            except KeyboardInterrupt:
                raise SystemExit(130) from None
        yield


def is_set_up() -> bool:
    """Return True where what has to be installed is in .venv."""
    return STAMP.exists() and not UNFINISHED.exists() and STAMP.read_text().strip() == digest() and PYTHON.exists()


def setup() -> None:
    """Install the locked versions and this package into .venv, unless that is done already."""
    if is_set_up():
        return
    with alone():
        if not is_set_up():  # another set-up may have done it meanwhile
            set_up()


def set_up() -> None:
    """Install the locked versions and this package into .venv."""
    current = digest()
    make_venv()
    UNFINISHED.touch()
    say("installing the versions of requirements.lock (about 1 GB, once)")
    install("-r", LOCK, reason="pip could not install requirements.lock, its own lines above say why; the next start tries again")
    package = ("--no-deps", "--no-build-isolation", "--editable", ROOT)
    install(*package, reason="pip could not install the package itself, its own lines above say why")
    STAMP.write_text(current + "\n")
    UNFINISHED.unlink()
    say("compiling kernels for this processor (under a minute, once)")
    if call(PYTHON, "-P", "-m", "irgspp", "compile") != 0:
        say("the kernels could not be compiled, its own lines above say why; the first job compiles those that it needs")
    say("set-up done: " + str(VENV))


def workers() -> list:
    """Return options of pytest: one process for each core, four at most, since each needs over 1 GB; a later `-n 0` overrules it."""
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    return ["-n", str(min(cores, 4)), "--dist", "worksteal"] if cores > 1 else []


def copy_package() -> None:
    """Copy the package to build/docs/irgspp, as the documentation's tool wants a folder of the package's name."""
    package = ROOT / "build" / "docs" / "irgspp"
    shutil.rmtree(str(package), ignore_errors=True)
    package.mkdir(parents=True)
    shutil.copy(str(ROOT / "__init__.py"), str(package))
    for room in ("core", "irgspp_addon", "operators", "panels"):
        shutil.copytree(str(ROOT / room), str(package / room), ignore=shutil.ignore_patterns("__pycache__", "demo_data"))


def main(arguments: list) -> int:
    """Run the command that the first argument names and return its exit status."""
    if not arguments or arguments[0] not in COMMANDS:
        fail("usage: python3 scripts/run.py setup|demo|test|docs [arguments passed on]")
    check_python()
    command, rest = arguments[0], arguments[1:]
    setup()
    if command == "test":
        return call(PYTHON, "-m", "pytest", *workers(), *rest)
    if command == "docs":
        install("-q", "-r", DOCS_LOCK, reason="pip could not install docs/requirements.lock, its own lines above say why")
        copy_package()
        return call(PYTHON, "-m", "mkdocs", "build", "--strict", *rest)
    if command == "demo":
        return call(PYTHON, "-P", "-m", "irgspp", "demo", *([] if "-o" in rest else ["-o", "demo"]), *rest)
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
