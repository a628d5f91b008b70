# SPDX-License-Identifier: GPL-3.0-or-later
"""Watch of the parent process: stdin, whose other end the parent holds, ends when the parent closes it or ends."""

from __future__ import annotations

import os
import threading
from collections.abc import Callable

PARENT_WATCH = "IRGSPP_TIED"  # environment variable that tells launch.py to end its process with the parent


def on_parent_exit(then: Callable[[], object]) -> None:
    """Call `then` in a thread of its own once stdin has ended; never where there is no stdin."""

    def watch() -> None:
        try:
            while os.read(0, 1 << 16):  # not sys.stdin, whose lock would be held when the process ends
                continue
        except OSError:
            return  # there is no stdin
        then()

    threading.Thread(target=watch, daemon=True, name="stdin").start()
