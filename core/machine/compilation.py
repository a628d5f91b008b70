# SPDX-License-Identifier: GPL-3.0-or-later
"""Notice of compilation: the first job of a version on a machine compiles its CPU kernels, for tens of seconds in all."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

from numba.core import event

COMPILE = "numba:compile"  # numba's event; it does not occur where a kernel comes from the cache on the disk


class _Listener(event.Listener):
    """Calls a function when a compilation begins."""

    def __init__(self, called: Callable[[], object]) -> None:
        self._called = called

    def on_start(self, event: Any) -> None:
        """Take note of the beginning of a compilation."""
        self._called()

    def on_end(self, event: Any) -> None:
        """Take note of the end of a compilation."""


@contextmanager
def compilations_reported(report: Callable[[], object]) -> Iterator[None]:
    """Call `report`, in any thread, whenever a kernel or a helper of one is compiled within the block.

    Args:
        report: called without arguments.
    """
    listener = _Listener(report)
    event.register(COMPILE, listener)
    try:
        yield
    finally:
        event.unregister(COMPILE, listener)


@contextmanager
def compilation_announced(announce: Callable[[], object]) -> Iterator[None]:
    """Call `announce` once, in any thread, when a kernel is first compiled within the block.

    Args:
        announce: called without arguments.
    """
    announced = False

    def first() -> None:
        nonlocal announced
        if not announced:
            announced = True
            announce()

    with compilations_reported(first):
        yield
