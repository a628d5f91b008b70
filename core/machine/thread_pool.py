# SPDX-License-Identifier: GPL-3.0-or-later
"""Thread pool for kernels over ranges: numba's prange changes its threading layer with bpy loaded and aborts after fork, threads don't."""

from __future__ import annotations

import itertools
import os
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor, wait
from functools import cache
from typing import Any, TypeVar

import numpy as np

from ..errors import Cancelled
from ..progress.protocol import Progress

Item = TypeVar("Item")
Result = TypeVar("Result")


def thread_count() -> int:
    """Return the number of threads to use: $IRGSPP_THREADS, or the cores that this process may run on."""
    if "IRGSPP_THREADS" in os.environ:
        return max(1, int(os.environ["IRGSPP_THREADS"]))
    return cores()


def cores() -> int:
    """Count the cores that this process may run on."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


@cache
def _executor(threads: int) -> ThreadPoolExecutor:
    return ThreadPoolExecutor(threads, thread_name_prefix="irgspp")


def even_ranges(count: int, parts: int) -> list[tuple[int, int]]:
    """Split items into contiguous non-empty ranges of about equal size.

    Args:
        count: number of items.
        parts: largest number of ranges.

    Returns:
        (begin, end) of each range, in order.
    """
    parts = max(1, min(parts, count))
    edges = [count * i // parts for i in range(parts + 1)]
    return [(a, b) for a, b in itertools.pairwise(edges) if b > a]


def balanced_ranges(cost: np.ndarray, parts: int) -> list[tuple[int, int]]:
    """Split items into contiguous non-empty ranges of about equal summed cost, always the same for the same input.

    Args:
        cost: (N,) cost of each item, >= 0.
        parts: largest number of ranges.

    Returns:
        (begin, end) of each range, in order.
    """
    total = np.cumsum(cost, dtype=np.float64)
    if not len(cost) or total[-1] <= 0:
        return even_ranges(len(cost), parts)
    inner = np.searchsorted(total, total[-1] * np.arange(1, parts) / parts)
    edges = np.unique(np.concatenate([[0], inner, [len(cost)]]))
    return [(int(a), int(b)) for a, b in itertools.pairwise(edges)]


def run_ranges(kernel: Callable[..., Any], ranges: Sequence[tuple[int, int]], *args: object, numbered: bool = False) -> list[Any]:
    """Call a kernel for every range, in the calling thread and on the thread pool, each in the next thread that is free.

    Args:
        kernel: called as `kernel(begin, end, *args)`.
        ranges: (begin, end) of each range.
        args: further arguments of each call.
        numbered: pass the index of the range as the kernel's first argument.

    Returns:
        The kernel's results in the order of the ranges.
    """
    calls = [((i, a, b) if numbered else (a, b)) for i, (a, b) in enumerate(ranges)]
    results: list[Any] = [None] * len(calls)
    waiting = iter(range(len(calls)))  # shared: each thread takes the next one

    def work() -> None:
        for i in waiting:
            results[i] = kernel(*calls[i], *args)

    threads = thread_count()
    helpers = [_executor(threads).submit(work) for _ in range(min(threads, len(calls)) - 1)]
    try:
        work()
    finally:
        helpers = [helper for helper in helpers if not helper.cancel()]  # those that have not begun have nothing left to do
        wait(helpers)
    for helper in helpers:
        helper.result()  # raises what was raised in its thread
    return results


def run_reported(function: Callable[[Item], Result], items: Iterable[Item], threads: int, progress: Progress, stopped: str) -> list[Result]:
    """Call a function for every item on threads of their own, report each finished item as a step, and stop when the user cancels.

    Args:
        function: called with one item.
        items: in the order of the results.
        threads: number of threads, which for large images memory limits.
        progress: receives the steps, and cancels.
        stopped: what was stopped, for the error's line.

    Returns:
        The results in the order of the items.

    Raises:
        Cancelled: if the user stopped the work; items that have not begun are dropped.
    """
    done: list[Result] = []
    with ThreadPoolExecutor(threads) as pool:
        for result in pool.map(function, items):
            done.append(result)
            progress.step(len(done))
            if progress.cancelled:
                pool.shutdown(cancel_futures=True)
                raise Cancelled(stopped)
    return done


def run_jobs(function: Callable[..., Any], jobs: Sequence[Sequence[Any]]) -> Iterator[Any]:
    """Call a function for every job on the thread pool, and yield the results in order as they arrive.

    Jobs that have not begun when the caller stops iterating are dropped. A function must not use the thread pool itself.

    Args:
        function: called as `function(*job)`.
        jobs: arguments of each call.
    """
    futures = [_executor(thread_count()).submit(function, *job) for job in jobs]
    try:
        for future in futures:
            yield future.result()
    finally:
        for future in futures:
            future.cancel()
        wait(futures)
