# SPDX-License-Identifier: GPL-3.0-or-later
"""Times that a busy machine distorts the least: medians of repeats, taken in turns where they are to be compared."""

from __future__ import annotations

import statistics
import time
from collections.abc import Callable, Mapping
from typing import Any

ENOUGH = 2.0  # seconds after which no further repeat is made


def median_seconds(work: Callable[[], Any], repeats: int, enough: float = ENOUGH) -> float:
    """Wall clock of `work` after one run that does not count; fewer repeats where they take long."""
    return medians({"": work}, repeats, enough)[""]


def medians(
    works: Mapping[str, Callable[[], Any]], repeats: int, enough: float = ENOUGH, clock: Callable[[], float] = time.perf_counter
) -> dict[str, float]:
    """The median time of each; they take turns, so that what else goes on hits all alike. `clock`: process_time counts CPU seconds."""
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
