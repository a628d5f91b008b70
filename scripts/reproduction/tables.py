# SPDX-License-Identifier: GPL-3.0-or-later
"""Tables of the papers with published rows next to ours: as Markdown, JSON and one HTML page."""

from __future__ import annotations

import tomllib
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
from reports.pages import Cell, embedded_jpeg, render
from reports.pages import Row as PageRow

PUBLISHED = tomllib.loads(Path(__file__).with_name("published.toml").read_text(encoding="utf-8"))
MEASURED = "measured here"
LONGEST = 1400  # pixels of a contact sheet's longer side on the page


@dataclass(frozen=True)
class Result:
    """Result of one scene.

    Attributes:
        scene: name of the scene.
        known_as: name that papers use.
        format: format of the dataset.
        report: JSON of the evaluation's report; None where there is none.
        minutes: minutes of the reconstruction.
        trouble: reason why there is no report.
        sheet: contact sheet.
    """

    scene: str
    known_as: str
    format: str
    report: dict[str, Any] | None
    minutes: float | None = None
    trouble: str = ""
    sheet: Path | None = None


@dataclass(frozen=True)
class Row:
    """Line of a table.

    Attributes:
        of: scene, or "mean".
        by: method.
        source: where the numbers are from.
        figures: metrics by the columns' keys.
    """

    of: str
    by: str
    source: str
    figures: dict[str, float]


@dataclass(frozen=True)
class Table:
    """Table of all scenes of one format.

    Attributes:
        title: title of the table.
        columns: heading by key.
        rows: lines of the table.
        notes: notes on how to read it.
    """

    title: str
    columns: dict[str, str]
    rows: list[Row]
    notes: list[str]


def benchmark_of(form: str) -> dict[str, Any]:
    """Return the published table of a format of datasets; the one without published rows where there is none."""
    return PUBLISHED.get(form, PUBLISHED["other"])


def tables_of(results: Sequence[Result], ours: str) -> list[Table]:
    """Return a table for each format among the results.

    Args:
        results: results of all scenes.
        ours: label of our rows.
    """
    by_format: dict[str, list[Result]] = {}
    for result in results:
        if result.format:
            by_format.setdefault(result.format, []).append(result)
    return [_table(form, of_format, ours) for form, of_format in sorted(by_format.items())]


def _table(form: str, results: Sequence[Result], ours: str) -> Table:
    """Return the table of a format."""
    known, measured = benchmark_of(form), [result for result in results if result.report]
    columns = dict(known["columns"])
    rows = [Row("mean", row["method"], row["source"], row["figures"]) for row in known.get("rows", [])]
    minutes = [result.minutes for result in measured if result.minutes is not None]
    if measured:
        mean = _mean([_figures(result, columns) for result in measured])
        rows.append(Row(f"mean of {len(measured)}", ours, MEASURED, mean | ({"minutes": float(np.mean(minutes))} if minutes else {})))
    for result in measured:
        for row in known.get("rows", []):
            if result.known_as in row.get("scenes", {}):
                rows.append(Row(result.scene, row["method"], row["source"], row["scenes"][result.known_as]))
        spent = {} if result.minutes is None else {"minutes": result.minutes}
        rows.append(Row(result.scene, ours, MEASURED, _figures(result, columns) | spent))
    columns["minutes"] = "minutes"
    keys = {name for row in rows for name in row.figures}
    return Table(known["title"], {key: text for key, text in columns.items() if key in keys}, rows, _notes(known, results))


def _figures(result: Result, columns: Mapping[str, str]) -> dict[str, float]:
    """Return a result's metrics for the columns."""
    assert result.report is not None
    return {key: result.report["figures"][key] for key in columns if key in result.report["figures"]}


def _mean(rows: Sequence[Mapping[str, float]]) -> dict[str, float]:
    """Return the means of the metrics that every scene has: a mean over some would look like one over all."""
    return {key: float(np.mean([row[key] for row in rows])) for key in rows[0] if all(key in row for row in rows)}


def _notes(known: Mapping[str, Any], results: Sequence[Result]) -> list[str]:
    """Return what differs from the published scenes, views or samples, and how our numbers were computed."""
    measured = [result for result in results if result.report]
    notes = [f"{result.scene} is missing: {result.trouble}" for result in results if not result.report]
    if known.get("rows") and {result.known_as for result in measured} != set(known["scenes"]):
        notes.append(f"Ours is not a mean over the published scenes ({', '.join(known['scenes'])}): the means can't be compared.")
    protocols = [line for result in measured for line in (result.report or {})["protocol"]]
    return [*notes, *known["notes"], *dict.fromkeys(line for line in protocols if not line.startswith("Scale of the albedo"))]


# --- formats


def as_markdown(tables: Sequence[Table]) -> str:
    """Return the tables as Markdown, with a heading each."""
    return "\n\n".join(_markdown(table) for table in tables) + "\n"


def _markdown(table: Table) -> str:
    """Return a table as Markdown."""
    lines = [f"## {table.title}", "", _line(["scene", "by", "source", *table.columns.values()])]
    lines.append(_line(["---"] * 3 + ["---:"] * len(table.columns)))
    lines += [_line([row.of, row.by, row.source, *(formatted(row.figures.get(key)) for key in table.columns)]) for row in table.rows]
    return "\n".join([*lines, "", *(f"- {note}" for note in table.notes)])


def _line(cells: Sequence[str]) -> str:
    """Return a Markdown row."""
    return "| " + " | ".join(cell.replace("|", "\\|") for cell in cells) + " |"


def as_json(tables: Sequence[Table]) -> list[dict[str, Any]]:
    """Return the tables as plain objects for JSON."""
    return [asdict(table) for table in tables]


def as_html(tables: Sequence[Table], results: Sequence[Result]) -> str:
    """Return one page with all tables and the contact sheet of each scene inside.

    Args:
        tables: tables in the order of the page.
        results: results of all scenes; those without one are listed with the reason.

    Returns:
        The HTML text.
    """
    values = {
        "title": "Reproduction",
        "troubles": [f"{result.scene}: {result.trouble}" for result in results if result.trouble],
        "tables": [_page_table(table) for table in tables],
        "sheets": [(r.scene, embedded_jpeg(r.sheet, LONGEST, quality=90)) for r in results if r.sheet is not None and r.sheet.is_file()],
    }
    return render("reproduction", **values)


def _page_table(table: Table) -> dict[str, Any]:
    """Return a table as the template takes it."""
    rows = []
    for row in table.rows:
        numbers = [Cell(formatted(row.figures.get(key)), is_text=False) for key in table.columns]
        rows.append(PageRow([*map(Cell, (row.of, row.by, row.source)), *numbers], "ours" if row.source == MEASURED else ""))
    columns = ["scene", "by", "source", *table.columns.values()]
    return {"title": table.title, "columns": columns, "rows": rows, "notes": table.notes}


def formatted(value: float | None) -> str:
    """Return a number in the digits that tables use; a dash for None."""
    if value is None:
        return "–"
    return f"{value:.2e}" if 0 < abs(value) < 1e-3 else f"{value:.3f}" if abs(value) < 1 else f"{value:.2f}"
