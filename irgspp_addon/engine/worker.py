# SPDX-License-Identifier: GPL-3.0-or-later
"""Process of a job: run a script that reports progress into a folder, stop it when Blender has ended, and record its exit status.

python worker.py FOLDER SESSION SCRIPT ARGUMENTS

FOLDER receives worker.json (process number) and exit.json (exit status), and holds worker.lock, which is locked while this process
lives. SESSION is a file that Blender keeps locked; when that lock is freed the job is cancelled, unless FOLDER holds a file `keep`.
This file uses the standard library alone and does not import the package, because it runs in any Python that the engine has.
"""

import contextlib
import faulthandler
import importlib.util
import json
import os
import runpy
import sys
import threading
import time
from pathlib import Path

WATCH_SECONDS = 1.0
GRACE_SECONDS = 60.0  # between the request to stop and the forced end


def load_lock():
    """Return the class FileLock of core/io/file_lock.py next to this file, without importing the package: the launcher does that later."""
    path = Path(__file__).resolve().parents[2] / "core" / "io" / "file_lock.py"
    spec = importlib.util.spec_from_file_location("irgspp_lock", path)
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module.FileLock


def write_json(path: Path, values: dict) -> None:
    """Write a JSON file atomically.

    Args:
        path: file to write.
        values: its content.
    """
    partial = path.with_name(path.name + ".part")
    partial.write_text(json.dumps(values), encoding="utf-8")
    os.replace(partial, path)


def is_free(lock_type, path: Path) -> bool:
    """Return True if no process holds the lock of a file, or the file does not exist.

    Args:
        lock_type: class FileLock.
        path: file that may be locked.
    """
    if not path.exists():
        return True
    try:
        lock_type(path).release()
    except BlockingIOError:
        return False
    return True


def acquire(lock_type, path: Path):
    """Lock a file, with retries for the moments in which another process tests the lock.

    Args:
        lock_type: class FileLock.
        path: file to lock.

    Returns:
        The held lock.
    """
    for _ in range(50):
        try:
            return lock_type(path)
        except BlockingIOError:
            time.sleep(0.02)
    return lock_type(path)


def watch(lock_type, folder: Path, session: Path) -> None:
    """Cancel the job when Blender has ended, and end this process if the job does not stop by itself.

    Args:
        lock_type: class FileLock.
        folder: folder of the job.
        session: file that Blender keeps locked.
    """
    while (folder / "keep").exists() or not is_free(lock_type, session):
        time.sleep(WATCH_SECONDS)
    print("irgspp: Blender has ended, so this job stops", file=sys.stderr, flush=True)
    with contextlib.suppress(OSError):  # such as a full disk: then the job is ended without a request to stop
        (folder / "cancel").touch()
        time.sleep(GRACE_SECONDS)
    os._exit(130)


def run(script: str, arguments: list) -> int:
    """Run a script as the main program.

    Args:
        script: path of the script.
        arguments: its command-line arguments.

    Returns:
        Its exit status.
    """
    sys.argv[:] = [script, *arguments]
    try:
        runpy.run_path(script, run_name="__main__")
    except SystemExit as end:
        if isinstance(end.code, str):
            print(end.code, file=sys.stderr)
            return 1
        return int(end.code or 0)
    return 0


def main(arguments: list) -> int:
    """Run the job that the command-line arguments describe, and return its exit status."""
    folder, session, script, *rest = arguments
    folder = Path(folder)
    faulthandler.enable()  # a crash in native code writes its stack to the log
    lock_type = load_lock()
    lock = acquire(lock_type, folder / "worker.lock")  # held until this process ends
    write_json(folder / "worker.json", {"pid": os.getpid(), "began": time.time()})
    os.environ["IRGSPP_JOB"] = str(folder)
    threading.Thread(target=watch, args=(lock_type, folder, Path(session)), daemon=True).start()
    status = 1
    try:
        status = run(script, rest)
    finally:
        write_json(folder / "exit.json", {"status": status, "ended": time.time()})
        sys.stdout.flush()
        sys.stderr.flush()
    del lock
    return status


if __name__ == "__main__":
    own_folder = os.path.dirname(os.path.abspath(__file__))
    # The package's modules must not be importable as top-level modules.
    sys.path[:] = [folder for folder in sys.path if os.path.abspath(folder or ".") != own_folder]
    sys.exit(main(sys.argv[1:]))
