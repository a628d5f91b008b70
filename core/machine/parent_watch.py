# SPDX-License-Identifier: GPL-3.0-or-later
"""How a process notices that the one that started it wants it to end, or is gone: its stdin, whose other end that one held, ends."""

from __future__ import annotations

import os
import threading
from collections.abc import Callable

PARENT_WATCH = "IRGSPP_TIED"  # variable of the environment: launch.py is to end its process then


def on_parent_exit(then: Callable[[], object]) -> None:
    """Call `then` in a thread of its own once stdin has ended; never where there is none."""

    def watch() -> None:
        try:
            while os.read(0, 1 << 16):  # not sys.stdin, whose lock would be held when the process ends
                continue
        except OSError:
            return  # there never was one
        then()

    threading.Thread(target=watch, daemon=True, name="stdin").start()
