# SPDX-License-Identifier: GPL-3.0-or-later
"""What a section of the benchmark is made of: tasks that measure, and blocks that show what was measured.

A section is a module of this package, named in `benchmark.SECTIONS`, with

    NAME = "geometry"           # as after --sections, and in every record
    TITLE = "Geometry"          # of its chapter in the report
    ABOUT = "What is compared, how, and which direction is better."
    ONCE = False                # True: tasks() is called once with scene None, for what no scene has a say in
    def tasks(bench: Bench, scene: Scene | None) -> Iterator[Task]
    def blocks(results: Results) -> Iterator[Block]

`tasks` only lists the work and measures nothing: a task whose record is in the store already is not done again, one that raises is recorded
as failed with its line. `blocks` reads records alone, so that a report can be made from a results.json at any time, on any machine.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from .runs import RunPlan

Figures = dict[str, float | int | str | None]


@dataclass(frozen=True, eq=False)
class Measurement:
    """What a task found.

    Attributes:
        figures: name to number, or to a short text; units are in the name ("seconds", "relight_psnr").
        counted: work done as counts (rays, hits, pixels, samples, iterations), which a busy machine does not change.
        images: name to (H, W, 3) uint8; kept as PNG files beside the results.
    """

    figures: Figures
    counted: dict[str, int] = field(default_factory=dict)
    images: dict[str, np.ndarray] = field(default_factory=dict)


@dataclass(frozen=True, eq=False)
class Task:
    """One measurement to be made.

    Attributes:
        configuration: what distinguishes it within its section and scene; with these it is the record's key.
        work: makes it.
        seconds: expected on two cores, without its runs; for the time left alone.
        runs: reconstructions that it needs (`Bench.run` makes them), which tasks share.
    """

    configuration: str
    work: Callable[[], Measurement]
    seconds: float = 3.0
    runs: Sequence[RunPlan] = ()


# --- what a report shows


@dataclass(frozen=True)
class Note:
    """A paragraph in plain words."""

    text: str


@dataclass(frozen=True)
class Table:
    """Rows of text or numbers (None: not known, shown as a dash) under column titles; give units and ↑ or ↓ (which is better) in these.

    detail: for the report alone, too long for docs/.
    """

    title: str
    columns: Sequence[str]
    rows: Sequence[Sequence[str | float | int | None]]
    detail: bool = False


@dataclass(frozen=True)
class Series:
    """Points joined by a line, or apart."""

    label: str
    x: Sequence[float]
    y: Sequence[float]
    line: bool = True


@dataclass(frozen=True)
class Chart:
    """Curves of one or several panels side by side (title of each to its series); `image` names the PNG that docs/ gets of it."""

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


def shown(value: str | float | int | None) -> str:
    """A cell's value as text: three or four digits that say something."""
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
