# SPDX-License-Identifier: GPL-3.0-or-later
"""Notice of compilation: the first job of a version on a machine compiles its CPU kernels, for tens of seconds in all."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

from numba.core import event

COMPILE = "numba:compile"  # numba's event; it does not occur where a kernel comes from the cache on the disk


class _First(event.Listener):
    """Calls a function at the first compilation."""

    def __init__(self, announce: Callable[[], object]) -> None:
        self._announce, self._announced = announce, False

    def on_start(self, event: Any) -> None:
        """Take note of the beginning of a compilation."""
        if not self._announced:
            self._announced = True
            self._announce()

    def on_end(self, event: Any) -> None:
        """Take note of the end of a compilation."""


@contextmanager
def compilation_announced(announce: Callable[[], object]) -> Iterator[None]:
    """Call `announce` once, in any thread, when a kernel is first compiled within the block.

    Args:
        announce: called without arguments.
    """
    listener = _First(announce)
    event.register(COMPILE, listener)
    try:
        yield
    finally:
        event.unregister(COMPILE, listener)
