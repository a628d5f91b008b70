# SPDX-License-Identifier: GPL-3.0-or-later
"""Imports of the large libraries, without the search for garbage meanwhile."""

from __future__ import annotations

import gc
from collections.abc import Iterator
from contextlib import contextmanager


@contextmanager
def quick_imports() -> Iterator[None]:
    """Return a context in which Python's garbage collector pauses.

    Modules stay, so that there is nothing to find, but it would search the growing heap again and again: a sixth of the time of importing
    torch.
    """
    paused = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if paused:
            gc.enable()
