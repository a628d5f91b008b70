# SPDX-License-Identifier: GPL-3.0-or-later
"""Command `irgspp serve`: keep a run loaded and answer requests for images through the files of a session folder.

    ready.json            written when the run is loaded: {"irgspp": version, "pid": ..., "gaussians": ...}
    request-CHANNEL.json  replaced by the client (core/relight/server/request.py); its "number" grows, the newest wins,
                          {"cancel": true} stops
    answer-CHANNEL.json   {"number", "pass", "passes", "share" (0..1), "picture" (a file or null), "done", "error" (a line or null)}
    CHANNEL-N-P.npy       the image of request N, pass P: (H, W, 4) float32 linear premultiplied, top row first
    stop                  ends the server; so does the end of its stdin, of its parent process, or of the folder

All files are written atomically. A channel belongs to one client; several are served in turn, first images before refined ones.
"""

from __future__ import annotations

import argparse
import os
import sys
import threading
from collections.abc import Callable
from pathlib import Path

from ..errors import InputError
from ..machine.parent_watch import on_parent_exit
from ..machine.quick_imports import quick_imports
from ..machine.version import VERSION
from ..progress.terminal import Terminal


def serve(args: argparse.Namespace, terminal: Terminal) -> int:
    """Answer requests until the session ends.

    Args:
        args: options of the command.
        terminal: receives the progress.
    """
    session = args.session
    if not session.is_dir():
        raise InputError(session, "is not a folder", "make the folder first")
    ended = _session_end(session, terminal)
    with quick_imports():
        from ..relight.server.loaded_run import LoadedRun
        from ..relight.server.request_server import RequestServer, write_json  # torch takes seconds, which other commands do without

    server = RequestServer(session, ended)
    run = LoadedRun(args.run, server.tick)
    run.warm_up()
    write_json(session / "ready.json", {"irgspp": VERSION, "pid": os.getpid(), "gaussians": run.reconstruction.gaussians.count})
    server.work(run)
    return 0


def add_options(one: argparse.ArgumentParser) -> None:
    """Add the options of `serve`, except the run folder, to its parser."""
    one.add_argument("--session", type=Path, required=True, metavar="DIR", help="folder for requests and images (core/cli/serve.py)")


def _session_end(session: Path, terminal: Terminal) -> Callable[[], bool]:
    """Return a test for the session's end: file `stop`, folder gone, stdin closed, parent process gone, or Ctrl-C."""
    closed, parent = threading.Event(), os.getppid()

    on_parent_exit(closed.set)

    def ended() -> bool:
        orphan = sys.platform != "win32" and os.getppid() != parent
        return closed.is_set() or terminal.cancelled or orphan or (session / "stop").exists() or not session.is_dir()

    return ended
