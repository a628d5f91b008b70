# SPDX-License-Identifier: GPL-3.0-or-later
"""COLMAP's library: silenced, on the CPU, with progress and cancellation of its long calls."""

from __future__ import annotations

import signal
import threading
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor, wait
from typing import TypeVar

import pycolmap

from ..errors import Cancelled
from ..progress.protocol import Progress

POLL = 0.1  # seconds between two looks at a long call
Result = TypeVar("Result")


def silence() -> None:
    """Keep COLMAP's log off the terminal and out of files; its errors reach us as exceptions.

    Its handler of SIGTERM, which prints a stack trace, gives way to the one that Python knows.
    """
    if threading.current_thread() is threading.main_thread():
        signal.signal(signal.SIGTERM, signal.getsignal(signal.SIGTERM) or signal.SIG_DFL)
    log = pycolmap.logging
    log.logtostderr = log.alsologtostderr = False
    log.stderrthreshold = log.minloglevel = pycolmap.logging.Level.FATAL.value
    for level in pycolmap.logging.Level.__members__.values():
        log.set_log_destination(level, "")


def run_call(
    call: Callable[[pycolmap.CancellationToken], Result], progress: Progress, stopped: str, done: Callable[[], int] = lambda: -1
) -> Result:
    """Run a long call of COLMAP in a thread, report its steps, and stop it when the user cancels.

    Args:
        call: called with the token that stops it.
        progress: receiver.
        stopped: what was stopped, for the error's line.
        done: returns the number of finished steps; -1 where it is not known.

    Returns:
        The call's result.

    Raises:
        Cancelled: if the user stopped the job.
    """
    token, reported = pycolmap.CancellationToken(), -1
    with ThreadPoolExecutor(1) as pool:
        future = pool.submit(call, token)
        try:
            while not wait([future], POLL).done:
                if progress.cancelled:
                    token.cancel()
                elif (now := done()) != reported:
                    reported = now
                    progress.step(now)
        except BaseException:  # of the receiver, or Ctrl-C: the thread must not go on alone
            token.cancel()
            raise
    if not token.is_cancelled and (now := done()) != reported:  # a fast call ends between two looks at it
        progress.step(now)
    if token.is_cancelled or progress.cancelled:
        raise Cancelled(stopped)
    return future.result()
