# SPDX-License-Identifier: GPL-3.0-or-later
"""Threads for range kernels: numba's prange changes its layer with bpy loaded and aborts after fork, plain threads don't."""

from __future__ import annotations

import itertools
import os
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from functools import cache
from typing import Any

import numpy as np


def thread_count() -> int:
    """Threads to use: $IRGSPP_THREADS, or the cores this process may run on."""
    if "IRGSPP_THREADS" in os.environ:
        return max(1, int(os.environ["IRGSPP_THREADS"]))
    return cores()


def cores() -> int:
    """Those that this process may run on."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


@cache
def _executor(threads: int) -> ThreadPoolExecutor:
    return ThreadPoolExecutor(threads, thread_name_prefix="irgspp")


def even_ranges(count: int, parts: int) -> list[tuple[int, int]]:
    """`count` items in at most `parts` contiguous non-empty ranges."""
    edges = np.linspace(0, count, max(1, min(parts, count)) + 1).astype(int)
    return [(int(a), int(b)) for a, b in itertools.pairwise(edges) if b > a]


def balanced_ranges(cost: np.ndarray, parts: int) -> list[tuple[int, int]]:
    """Contiguous ranges over (N,) items of about equal summed cost, the same for the same input."""
    total = np.cumsum(cost, dtype=np.float64)
    if not len(cost) or total[-1] <= 0:
        return even_ranges(len(cost), parts)
    inner = np.searchsorted(total, total[-1] * np.arange(1, parts) / parts)
    edges = np.unique(np.concatenate([[0], inner, [len(cost)]]))
    return [(int(a), int(b)) for a, b in itertools.pairwise(edges)]


def run_ranges(kernel: Callable[..., Any], ranges: Sequence[tuple[int, int]], *args: object, numbered: bool = False) -> list[Any]:
    """Call `kernel(begin, end, *args)` for every range on the pool, results in order; `numbered` puts the range's index first."""
    calls = [((i, a, b) if numbered else (a, b)) for i, (a, b) in enumerate(ranges)]
    if len(calls) == 1:
        return [kernel(*calls[0], *args)]
    return [future.result() for future in [_executor(thread_count()).submit(kernel, *call, *args) for call in calls]]
