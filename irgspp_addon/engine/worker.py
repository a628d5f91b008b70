# SPDX-License-Identifier: GPL-3.0-or-later
"""A job's process: run a script with progress into a folder, stop when the Blender that asked for it is gone, leave the exit status.

python worker.py FOLDER SESSION SCRIPT ARGUMENTS

FOLDER gets worker.json (the process), exit.json (its end) and holds worker.lock, locked as long as this process lives. SESSION is a
file that Blender keeps locked; once that lock is free the job is cancelled, unless FOLDER holds a file `keep`. Only the standard
library is used, as this runs in whatever Python the engine has.
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
GRACE_SECONDS = 60.0  # between asking the work to stop and ending it


def load_lock():
    """core/io/file_lock.py of this very folder, without importing the package: the launcher does that later."""
    path = Path(__file__).resolve().parents[2] / "core" / "io" / "file_lock.py"
    spec = importlib.util.spec_from_file_location("irgspp_lock", path)
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module.FileLock


def write_json(path: Path, values: dict) -> None:
    partial = path.with_name(path.name + ".part")
    partial.write_text(json.dumps(values), encoding="utf-8")
    os.replace(partial, path)


def is_free(lock_type, path: Path) -> bool:
    """True once nobody holds the lock of the file; a file that is gone has no holder either."""
    if not path.exists():
        return True
    try:
        lock_type(path).release()
    except BlockingIOError:
        return False
    return True


def patiently(lock_type, path: Path):
    """Lock the file, even where someone is just looking whether it is locked."""
    for _ in range(50):
        try:
            return lock_type(path)
        except BlockingIOError:
            time.sleep(0.02)
    return lock_type(path)


def watch(lock_type, folder: Path, session: Path) -> None:
    """Cancel the job once Blender is gone; end it where it doesn't stop by itself."""
    while (folder / "keep").exists() or not is_free(lock_type, session):
        time.sleep(WATCH_SECONDS)
    print("irgspp: Blender has ended, so this job stops", file=sys.stderr, flush=True)
    with contextlib.suppress(OSError):  # a full disk: then it is ended without being asked
        (folder / "cancel").touch()
        time.sleep(GRACE_SECONDS)
    os._exit(130)


def run(script: str, arguments: list) -> int:
    """Run the script as the main program; its exit status."""
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
    folder, session, script, *rest = arguments
    folder = Path(folder)
    faulthandler.enable()  # a crash in native code leaves where it was in the log
    lock_type = load_lock()
    lock = patiently(lock_type, folder / "worker.lock")  # held until this process is no more
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
    here = os.path.dirname(os.path.abspath(__file__))
    sys.path[:] = [place for place in sys.path if os.path.abspath(place or ".") != here]  # our modules are no top-level ones
    sys.exit(main(sys.argv[1:]))
