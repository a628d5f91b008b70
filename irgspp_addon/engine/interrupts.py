# SPDX-License-Identifier: GPL-3.0-or-later
"""Handling of Ctrl-C and SIGTERM while a script waits for a job."""

from __future__ import annotations

import signal
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager

import bpy


@contextmanager
def on_interrupt(stop: Callable[[], object]) -> Iterator[None]:
    """Call `stop` for each SIGINT or SIGTERM within the block, instead of ending this process; in a window Blender's handling stays."""
    if not bpy.app.background or threading.current_thread() is not threading.main_thread():
        yield
        return
    before = {kind: signal.signal(kind, lambda number, frame: stop()) for kind in (signal.SIGINT, signal.SIGTERM)}
    try:
        yield
    finally:
        for kind, handler in before.items():
            signal.signal(kind, signal.SIG_DFL if handler is None else handler)  # None: set by Blender itself, unknown to Python
