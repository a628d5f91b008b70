# SPDX-License-Identifier: GPL-3.0-or-later
"""Engine whose processes are copies of one that has loaded the libraries, which else takes each of them two seconds of a core.

`engine()` returns a program to be used as the engine's Python. It passes its command line, folder, environment and streams to the server
that this file is as a script, and ends as the copy does that the server makes of itself; signals are passed on, and the copy is killed
when the program is. Tests of starts, crashes and limits use the real Python.
"""

import atexit
import contextlib
import functools
import importlib
import io
import json
import os
import runpy
import select
import shutil
import signal
import socket
import subprocess
import sys
import tempfile
import threading
import traceback
from pathlib import Path

BEFORE = set(os.environ)
ROOT = Path(__file__).resolve().parents[2]
LOADED = ("pipeline", "cli.main", "cli.commands", "cli.render", "cli.serve", "assets.export", "assets.rebake")
CLIENT = """
import json, os, signal, socket, sys
python, address, *words = sys.argv[1:]
if not words or (words[0].startswith("-") and words[0] != "-c"):
    os.execv(python, [python, *words])
asked = json.dumps([words, os.getcwd(), dict(os.environ)]).encode()
server = socket.socket(socket.AF_UNIX)
server.connect(address)
socket.send_fds(server, [len(asked).to_bytes(8, "big")], [0, 1, 2])
server.sendall(asked)
told = server.makefile()
copy = int(told.readline())
for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
    signal.signal(number, lambda number, frame: os.kill(copy, number))
status = int(told.readline())
if status < 0:
    signal.signal(-status, signal.SIG_DFL) if -status != signal.SIGKILL else None
    os.kill(os.getpid(), -status)
os._exit(status)
"""


@functools.cache
def engine(python: str) -> str:
    """Start a server in a Python, and return the program that stands for it; where processes can't be copied, that is the Python."""
    if not hasattr(os, "fork"):
        return python
    folder = Path(tempfile.mkdtemp(prefix="irgspp-warm-"))  # the server removes it, as this process may end without any last words
    words = [python, "-P", __file__, str(folder / "socket")]
    server = subprocess.Popen(words, stdin=subprocess.PIPE, stdout=subprocess.PIPE, start_new_session=True)
    assert server.stdin is not None and server.stdout is not None

    def end() -> None:
        server.stdin.close()
        server.wait()

    atexit.register(end)
    assert server.stdout.readline() == b"ready\n"
    (folder / "client.py").write_text(CLIENT)
    program = folder / "python"
    program.write_text(f'#!/bin/sh\nexec "{python}" -IS "{folder}/client.py" "{python}" "{folder}/socket" "$@"\n')
    program.chmod(0o755)
    return str(program)


def serve(address: str) -> None:
    """Load the libraries, and make copies until stdin ends."""
    runpy.run_path(str(ROOT / "irgspp_addon" / "launch.py"))["mount"](ROOT)
    for name in LOADED:
        importlib.import_module(f"irgspp.core.{name}")
    listener = socket.socket(socket.AF_UNIX)
    listener.bind(address)
    listener.listen()
    print("ready", flush=True)
    while 0 not in (ready := select.select([listener, 0], [], [], 1.0)[0]):
        with contextlib.suppress(ChildProcessError):
            while os.waitpid(-1, os.WNOHANG)[0]:
                continue
        if ready:
            connection, _ = listener.accept()
            if os.fork() == 0:
                listener.close()
                attend(connection)
                os._exit(0)
            connection.close()
    shutil.rmtree(Path(address).parent, ignore_errors=True)


def attend(connection: socket.socket) -> None:
    """Make a copy for a client, tell it the copy's number and exit status, and kill the copy when the client is gone."""
    length, streams, _, _ = socket.recv_fds(connection, 8, 3)
    asked = b""
    while len(asked) < int.from_bytes(length, "big"):
        asked += connection.recv(1 << 16)
    copy = os.fork()
    if copy == 0:
        connection.close()
        become(streams, *json.loads(asked))
    for stream in streams:
        os.close(stream)
    connection.sendall(b"%d\n" % copy)

    def watch() -> None:
        connection.recv(1)
        with contextlib.suppress(ProcessLookupError):
            os.kill(copy, signal.SIGKILL)

    threading.Thread(target=watch, daemon=True).start()
    status = os.waitstatus_to_exitcode(os.waitpid(copy, 0)[1])
    with contextlib.suppress(BrokenPipeError):
        connection.sendall(b"%d\n" % status)


def become(streams: list[int], words: list[str], folder: str, variables: dict[str, str]) -> None:
    """Do in this process what Python does that is started with these words, and end it."""
    os.setsid()
    for number, stream in enumerate(streams):
        os.dup2(stream, number)
        os.close(stream)
    sys.stdin = open(0, encoding="utf-8", closefd=False)  # noqa: SIM115 (as long as the process)
    sys.stdout, sys.stderr = (io.TextIOWrapper(io.FileIO(n, "w", closefd=False), "utf-8", write_through=True) for n in (1, 2))
    set_by_libraries = {name: value for name, value in os.environ.items() if name not in BEFORE}
    os.environ.clear()
    os.environ.update(set_by_libraries | variables)
    del sys.modules["irgspp.core"]  # its next import makes it an attribute of the package that the launcher mounts anew
    status = 1
    try:
        os.chdir(folder)
        if words[0] == "-c":
            sys.argv, sys.path[:0] = ["-c", *words[2:]], [""]
            exec(compile(words[1], "<string>", "exec"), {"__name__": "__main__"})
        else:
            sys.argv, sys.path[:0] = words, [str(Path(words[0]).resolve().parent)]
            runpy.run_path(words[0], run_name="__main__")
        status = 0
    except SystemExit as end:
        status = end.code if isinstance(end.code, int) else int(end.code is not None)
        if isinstance(end.code, str):
            print(end.code, file=sys.stderr)
    except BaseException:
        traceback.print_exc()
    finally:
        threading._shutdown()
        atexit._run_exitfuncs()
        os._exit(status & 0xFF)


if __name__ == "__main__":
    serve(sys.argv[1])
