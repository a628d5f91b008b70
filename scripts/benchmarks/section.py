# SPDX-License-Identifier: GPL-3.0-or-later
"""Interface of a section of the benchmark: tasks that measure, and blocks of the report.

A section is a module of this package, named in `benchmark.SECTIONS`, with

    NAME = "geometry"           # as after --sections, and in every record
    TITLE = "Geometry"          # of its chapter in the report
    ABOUT = "What is compared, how, and which direction is better."
    ONCE = False                # True: tasks() is called once with scene None, for what does not depend on a scene
    def tasks(bench: Bench, scene: Scene | None) -> Iterator[Task]
    def blocks(results: Results) -> Iterator[Block]

`tasks` only lists the work and measures nothing: a task whose record is in the store is not repeated, one that raises is recorded as failed
with its message. `blocks` reads records alone, so that a report can be made from a results.json at any time, on any machine.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from .runs import RunPlan

Figures = dict[str, float | int | str | None]


@dataclass(frozen=True, eq=False)
class Measurement:
    """Result of a task.

    Attributes:
        figures: name to number, or to a short text; units are in the name ("seconds", "relight_psnr").
        counted: work as counts (rays, hits, pixels, samples, iterations), which other load on the machine does not change.
        images: name to (H, W, 3) uint8; stored as PNG files next to the results.
    """

    figures: Figures
    counted: dict[str, int] = field(default_factory=dict)
    images: dict[str, np.ndarray] = field(default_factory=dict)


@dataclass(frozen=True, eq=False)
class Task:
    """Measurement to make.

    Attributes:
        configuration: distinguishes the task within its section and scene; the three are the key of the record.
        work: makes the measurement.
        seconds: expected seconds on two cores without the runs, for the estimate of the remaining time.
        runs: reconstructions that the task needs and shares with others (`Bench.run` makes them).
    """

    configuration: str
    work: Callable[[], Measurement]
    seconds: float = 3.0
    runs: Sequence[RunPlan] = ()


# --- blocks of a report


@dataclass(frozen=True)
class Note:
    """Paragraph of text."""

    text: str


@dataclass(frozen=True)
class Table:
    """Table of text and numbers (None: not known, shown as a dash).

    Attributes:
        title: title of the table.
        columns: headings with units and ↑ or ↓ for the better direction.
        rows: cells of each row.
        detail: True for the report alone, where it is too long for docs/.
    """

    title: str
    columns: Sequence[str]
    rows: Sequence[Sequence[str | float | int | None]]
    detail: bool = False


@dataclass(frozen=True)
class Series:
    """Points of a chart, joined by a line or not.

    Attributes:
        label: name in the legend.
        x: abscissae, (N,).
        y: ordinates, (N,).
        line: True to join the points.
    """

    label: str
    x: Sequence[float]
    y: Sequence[float]
    line: bool = True


@dataclass(frozen=True)
class Chart:
    """Chart of one or several panels side by side.

    Attributes:
        title: title of the chart.
        x: label of the abscissa.
        y: label of the ordinate.
        panels: series of each panel by its title.
        log_x: True for a logarithmic abscissa.
        log_y: True for a logarithmic ordinate.
        image: name of the PNG file in docs/; "" for none.
    """

    title: str
    x: str
    y: str
    panels: Mapping[str, Sequence[Series]]
    log_x: bool = True
    log_y: bool = True
    image: str = ""


@dataclass(frozen=True)
class Images:
    """Rows of images: (caption, file relative to the report's folder)."""

    title: str
    rows: Sequence[Sequence[tuple[str, str]]]


Block = Note | Table | Chart | Images


def formatted(value: str | float | int | None) -> str:
    """Return a cell's value as text with three or four significant digits."""
    if value is None:
        return "–"
    if isinstance(value, str):
        return value
    if isinstance(value, int):
        return f"{value:,}"
    size = abs(value)
    if 0 < size < 1e-3:
        return f"{value:.1e}"
    digits = next(digits for least, digits in ((1000, 0), (100, 1), (1, 2), (0.01, 3), (0, 4)) if size >= least)
    return f"{value:,.{digits}f}"
