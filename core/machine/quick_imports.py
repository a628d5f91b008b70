# SPDX-License-Identifier: GPL-3.0-or-later
"""Imports of the large libraries, without the search for garbage in what they load."""

from __future__ import annotations

import gc
import sys
from collections.abc import Iterator
from contextlib import contextmanager


@contextmanager
def quick_imports() -> Iterator[None]:
    """Return a context in which Python's garbage collector pauses, and after which it leaves out what is there if modules were loaded.

    Modules stay, so that there is nothing to find, but it would search the growing heap again and again: a sixth of the time of importing
    torch, and half a second of each short job after it.
    """
    paused, before = gc.isenabled(), len(sys.modules)
    gc.disable()
    try:
        yield
    finally:
        if len(sys.modules) > before:
            gc.freeze()
        if paused:
            gc.enable()
