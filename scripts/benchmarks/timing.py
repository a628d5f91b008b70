# SPDX-License-Identifier: GPL-3.0-or-later
"""Timings that other load on the machine distorts little: medians of repeats, alternating where they are compared."""

from __future__ import annotations

import statistics
import time
from collections.abc import Callable, Mapping
from typing import Any

ENOUGH = 2.0  # seconds of one work after which it is not repeated again


def median_seconds(work: Callable[[], Any], repeats: int, enough: float = ENOUGH) -> float:
    """Return the median wall clock of a function after one call that does not count.

    Args:
        work: function to time.
        repeats: calls to time.
        enough: seconds after which there are no further repeats.
    """
    return medians({"": work}, repeats, enough)[""]


def medians(
    works: Mapping[str, Callable[[], Any]], repeats: int, enough: float = ENOUGH, clock: Callable[[], float] = time.perf_counter
) -> dict[str, float]:
    """Return the median time of several functions, which alternate so that other load affects all alike.

    Args:
        works: functions by name.
        repeats: calls of each.
        enough: seconds for each after which there are no further repeats.
        clock: clock in seconds; `time.process_time` counts CPU time.

    Returns:
        Seconds by name.
    """
    times: dict[str, list[float]] = {name: [] for name in works}
    for work in works.values():
        work()
    began = time.perf_counter()
    for _ in range(repeats):
        for name, work in works.items():
            before = clock()
            work()
            times[name].append(clock() - before)
        if time.perf_counter() - began > enough * len(works):
            break
    return {name: statistics.median(values) for name, values in times.items()}
