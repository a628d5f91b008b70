# SPDX-License-Identifier: GPL-3.0-or-later
"""Charts of the benchmark as SVG elements and PNG files, in the colours of the report."""

from __future__ import annotations

import io
from pathlib import Path
from typing import Any

import matplotlib

matplotlib.use("Agg")  # draws without a screen
from matplotlib import pyplot
from matplotlib.figure import Figure
from matplotlib.ticker import FixedLocator, FuncFormatter, LogLocator, NullFormatter, NullLocator

from .section import Chart

INK, FAINT, GROUND, PANEL = "#e2e2de", "#55575d", "#18191c", "#1f2024"
COLOURS = ("#f2a33a", "#5fb4e8", "#8fd175", "#e8718d", "#b79af0", "#e6d95c", "#5fd6c4", "#c98f63", "#9aa0a8", "#f08be0")
MARKERS = "osD^vPX*<>"
STYLE: Any = {  # matplotlib's own names
    "figure.facecolor": GROUND,
    "axes.facecolor": PANEL,
    "axes.edgecolor": FAINT,
    "axes.labelcolor": INK,
    "axes.titlecolor": INK,
    "text.color": INK,
    "xtick.color": INK,
    "ytick.color": INK,
    "grid.color": "#34363b",
    "legend.frameon": False,
    "font.size": 10,
    "axes.titlesize": 11,
    "svg.fonttype": "path",
    "svg.hashsalt": "irgspp",
}
WIDTH, HEIGHT, MOST = 4.3, 3.5, 3  # inches of a panel; most panels in a row
FEW = 9  # with at most so many different numbers an axis names each of them


def svg(chart: Chart) -> str:
    """Return a chart as an <svg> element without the header of an SVG file."""
    data = io.StringIO()
    with matplotlib.rc_context(STYLE):
        figure = _draw(chart)
        figure.savefig(data, format="svg", metadata={"Date": None})
        pyplot.close(figure)
    text = data.getvalue()
    return text[text.index("<svg") :]


def png(chart: Chart, path: Path) -> None:
    """Write a chart as a small PNG file.

    Args:
        chart: chart to draw.
        path: file to write.
    """
    with matplotlib.rc_context(STYLE):
        figure = _draw(chart)
        figure.savefig(path, dpi=100)
        pyplot.close(figure)


def _draw(chart: Chart) -> Figure:
    """Draw a chart as panels in rows with one legend below."""
    panels = {title: [s for s in series if len(s.x)] for title, series in chart.panels.items()}
    columns = min(len(panels), MOST)
    rows = -(-len(panels) // columns)
    labels = list(dict.fromkeys(s.label for series in panels.values() for s in series))
    legend_rows = -(-len(labels) // (3 * columns if columns > 1 else 2))
    height = HEIGHT * rows + 0.24 * legend_rows + 0.2
    figure, axes = pyplot.subplots(rows, columns, figsize=(WIDTH * columns if columns > 1 else 1.5 * WIDTH, height), squeeze=False)
    for axis in axes.flat[len(panels) :]:
        axis.set_visible(False)
    for axis, (title, series) in zip(axes.flat, panels.items(), strict=False):
        for one in series:
            number = labels.index(one.label)
            colour, marker = COLOURS[number % len(COLOURS)], MARKERS[number % len(MARKERS)]
            axis.plot(one.x, one.y, marker=marker, ms=4.5, lw=1.6 if one.line else 0, color=colour, label=one.label)
        _dress(axis, chart, title if len(panels) > 1 else "")
    handles = {label: h for axis in axes.flat for h, label in zip(*axis.get_legend_handles_labels(), strict=True)}
    columns = max(1, -(-len(labels) // max(legend_rows, 1)))
    figure.legend([handles[label] for label in labels], labels, loc="lower center", ncols=columns, fontsize=9)
    figure.tight_layout(rect=(0, (0.26 * legend_rows + 0.05) / height, 1, 1))
    return figure


def _dress(axis, chart: Chart, title: str) -> None:
    """Label a panel's axes and set their scales."""
    axis.set_title(title)
    axis.set_xlabel(chart.x)
    axis.set_ylabel(chart.y)
    axis.grid(True, which="major", lw=0.7)
    axis.grid(True, which="minor", lw=0.3)
    for log, name in ((chart.log_x, "x"), (chart.log_y, "y")):
        if log and axis.lines:
            _logarithmic(axis, name)
    numbers = sorted({float(x) for line in axis.lines for x in line.get_xdata()})
    if (
        chart.log_x and len(numbers) <= FEW and all(x.is_integer() for x in numbers)
    ):  # counts chosen for the measurement: label each of them
        axis.xaxis.set_major_locator(FixedLocator(numbers))
        axis.xaxis.set_minor_locator(NullLocator())


def _logarithmic(axis, name: str) -> None:
    """Make an axis logarithmic with labels at 1, 2, 5: curves here span one decade or two, where powers of ten alone say little."""
    getattr(axis, f"set_{name}scale")("log")
    low, high = getattr(axis, f"get_{name}lim")()
    ruler = getattr(axis, f"{name}axis")
    ruler.set_major_locator(LogLocator(subs=(1, 2, 5) if high < 300 * low else (1,), numticks=30))
    ruler.set_minor_locator(LogLocator(subs=tuple(range(1, 10)), numticks=200))
    ruler.set_major_formatter(FuncFormatter(lambda value, _: plain(value)))
    ruler.set_minor_formatter(NullFormatter())


def plain(value: float) -> str:
    """Return a number in few letters: 0.02, 512, 1024, 16.4k, 1.05M."""
    if value >= 1e6:
        return f"{value / 1e6:.3g}M"
    return f"{value / 1e3:.3g}k" if value >= 1e4 or (value >= 1e3 and value % 1e3 == 0) else f"{value:g}"
