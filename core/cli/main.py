# SPDX-License-Identifier: GPL-3.0-or-later
"""Entry point of the command line: `irgspp demo|inspect|capture|reconstruct|render|serve|evaluate|batch|export|bake|devices|compile`."""

from __future__ import annotations

import argparse
import os
import shlex
import subprocess
import sys
import tempfile
import traceback
from collections.abc import Sequence
from pathlib import Path

from ..errors import Cancelled, IrgsppError
from ..machine.freed_memory import keep_freed_memory
from ..machine.out_of_resources import as_out_of_resources
from ..progress.recorder import JobLog, JobRecorder
from ..progress.terminal import Terminal
from .option_values import decimal_words
from .parser import parser

JOB_FOLDER = "IRGSPP_JOB"  # environment variable


def main(arguments: Sequence[str] | None = None) -> int:
    """Run one command and return its exit status: 0 done, 1 failed, 2 bad usage or bad input, 130 cancelled."""
    keep_freed_memory()
    words = list(sys.argv[1:] if arguments is None else arguments)
    try:
        args = parser().parse_args(decimal_words(words))
    except SystemExit as end:
        return int(end.code or 0)
    with Terminal().signals() as terminal:
        return _run(args, words, recorded(terminal))


def recorded(terminal: Terminal) -> Terminal | JobRecorder:
    """Return a receiver of progress that also records it in the folder $IRGSPP_JOB, where the starting program has set that."""
    folder = os.environ.pop(JOB_FOLDER, "")
    return JobRecorder(JobLog(Path(folder)), terminal) if folder else terminal


def _run(args: argparse.Namespace, words: list[str], terminal: Terminal | JobRecorder) -> int:
    try:
        return args.command(args, terminal)
    except Cancelled as error:
        _print_error(terminal, f"cancelled: {error}")
        if args.resumable or args.repeatable:
            _print_error(terminal, f"resume with: {resume_line(words, () if args.repeatable else ('--resume',))}")
        return error.exit_status
    except IrgsppError as error:
        _print_error(terminal, str(error))
        return error.exit_status
    except Exception as error:  # a bug, or a lack of resources: one line here, the traceback in the log
        short, log = as_out_of_resources(error, getattr(args, "run", Path()), args.resumable), _keep_traceback(args)
        line = str(short) if short else f"failed: {type(error).__name__}: {' '.join(str(error).split())}"
        _print_error(terminal, line + (f" (more in {log})" if log else ""))
        return 1


def _print_error(terminal: Terminal | JobRecorder, line: str) -> None:
    terminal.end_line()
    print(f"irgspp: {line}", file=sys.stderr, flush=True)


def _keep_traceback(args: argparse.Namespace) -> Path | None:
    """Append the traceback to the run's log.txt, or to a new temporary file where there is none; return that file, None on a full disk."""
    run = getattr(args, "run", None)
    try:
        if run is not None and (run / "log.txt").exists():
            log = run / "log.txt"
        else:
            handle, name = tempfile.mkstemp(prefix="irgspp-", suffix=".log")
            os.close(handle)
            log = Path(name)
        with log.open("a", encoding="utf-8") as file:
            traceback.print_exc(file=file)
    except OSError:
        return None
    return log


def resume_line(words: Sequence[str], options: Sequence[str] = ("--resume",)) -> str:
    """Return the command line that resumes a stopped command.

    Args:
        words: of the stopped command.
        options: that make the command go on; none where it does so by itself.
    """
    kept = [word for word in words if word not in ("--resume", "--overwrite")]
    join = subprocess.list2cmdline if sys.platform == "win32" else shlex.join
    return join(["irgspp", *kept, *options])
