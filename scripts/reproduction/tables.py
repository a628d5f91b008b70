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
MEASURED, MEASURED_STAND_IN = "measured here", "measured here, stand-in"
TRUTHS = {
    "relight_": "relit ground truth with its light maps",
    "albedo_": "true albedo",
    "normal_": "true normals",
    "roughness_": "true roughness",
    "environment_": "true light",
}  # by the beginning of the metrics that need it
LONGEST = 1400  # pixels of a contact sheet's longer side on the page


@dataclass(frozen=True)
class Result:
    """Result of one scene.

    Attributes:
        scene: name of the scene.
        known_as: name that papers use.
        format: format of the dataset.
        report: JSON of the evaluation's report; None where there is none.
        hours: hours of the reconstruction.
        trouble: reason why there is no report.
        sheet: contact sheet.
        stand_in: the scene stands in for a published one.
    """

    scene: str
    known_as: str
    format: str
    report: dict[str, Any] | None
    hours: float | None = None
    trouble: str = ""
    sheet: Path | None = None
    stand_in: bool = False

    @property
    def source(self) -> str:
        """Source of its numbers."""
        return MEASURED_STAND_IN if self.stand_in else MEASURED

    @property
    def protocol(self) -> str:
        """Name of the protocol of its report."""
        return str((self.report or {})["choices"]["name"])


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
        heads: headings of the columns of text.
    """

    title: str
    columns: dict[str, str]
    rows: list[Row]
    notes: list[str]
    heads: tuple[str, str, str] = ("scene", "by", "source")


def benchmark_of(form: str) -> dict[str, Any]:
    """Return the published table of a format of datasets; the one without published rows where there is none."""
    return PUBLISHED.get(form, PUBLISHED["other"])


def tables_of(results: Sequence[Result], ours: str) -> list[Table]:
    """Return a table for each format among the results, and one for each protocol where they have several; stand-ins have their own.

    Args:
        results: results of all scenes.
        ours: label of our rows.
    """
    groups: dict[tuple[str, bool, str], list[Result]] = {}
    for result in results:
        if result.format:
            protocol = result.protocol if result.report else benchmark_of(result.format)["protocol"]
            groups.setdefault((result.format, result.stand_in, protocol), []).append(result)
    return [_table(benchmark_of(form), protocol, group, ours) for (form, _, protocol), group in sorted(groups.items())]


def _table(known: Mapping[str, Any], protocol: str, results: Sequence[Result], ours: str) -> Table:
    """Return the table of a format's results by one protocol."""
    measured, columns = [result for result in results if result.report], dict(known["columns"])
    rows = [Row("mean", row["method"], row["source"], row["figures"]) for row in known.get("rows", [])]
    if measured:
        mean = _mean([_figures(result, columns) for result in measured])
        rows.append(Row(f"mean of {len(measured)}", ours, measured[0].source, mean))
    for result in results:
        for row in known.get("rows", []) if not result.stand_in else ():
            if result.known_as in row.get("scenes", {}):
                rows.append(Row(result.scene, row["method"], row["source"], row["scenes"][result.known_as]))
        source = result.source if result.report else f"no run: {result.trouble}"
        rows.append(Row(result.scene, ours, source, _figures(result, columns)))
    keys = {name for row in rows for name in row.figures}
    shown = {key: text for key, text in columns.items() if key in keys}
    kind = ", stand-ins" if results[0].stand_in else ""
    return Table(f"{known['title']}{kind} (protocol {protocol})", shown, rows, _notes(known, protocol, results))


def _figures(result: Result, columns: Mapping[str, str]) -> dict[str, float]:
    """Return a result's metrics for the columns."""
    figures = dict((result.report or {}).get("figures", {})) | ({} if result.hours is None else {"hours": result.hours})
    return {key: figures[key] for key in columns if key in figures}


def _mean(rows: Sequence[Mapping[str, float]]) -> dict[str, float]:
    """Return the means of the metrics that every scene has: a mean over some would look like one over all."""
    return {key: float(np.mean([row[key] for row in rows])) for key in rows[0] if all(key in row for row in rows)}


def _notes(known: Mapping[str, Any], protocol: str, results: Sequence[Result]) -> list[str]:
    """Return what differs from the published scenes, views or samples, and how our numbers were computed."""
    measured = [result for result in results if result.report]
    notes = []
    if results[0].stand_in:
        notes.append("Stand-ins in the layout of this dataset, not its scenes: ours can't be compared with published rows.")
    elif known.get("rows") and {result.known_as for result in measured} != set(known["scenes"]):
        notes.append(f"Ours is not a mean over the published scenes ({', '.join(known['scenes'])}): the means can't be compared.")
    if known.get("rows") and protocol != known["protocol"]:
        notes.append(f"Ours are by protocol {protocol}, published rows by {known['protocol']}: they can't be compared.")
    if "unknown" in known:
        notes.append(f"No figures at hand of {', '.join(known['unknown'])}.")
    notes += [f"{result.scene} has no {missing}." for result in measured if (missing := _missing(result, known["columns"]))]
    protocols = [line for result in measured for line in (result.report or {})["protocol"]]
    return [*notes, *known["notes"], *dict.fromkeys(line for line in protocols if not line.startswith("Scale of the albedo"))]


def _missing(result: Result, columns: Mapping[str, str]) -> str:
    """Return the ground truth that a result lacks for a table's columns, in words; "" for none."""
    figures = _figures(result, columns)
    return ", ".join(
        text
        for prefix, text in TRUTHS.items()
        if any(c.startswith(prefix) for c in columns) and not any(f.startswith(prefix) for f in figures)
    )


# --- formats


def as_markdown(tables: Sequence[Table]) -> str:
    """Return the tables as Markdown, with a heading each."""
    return "\n\n".join(_markdown(table) for table in tables) + "\n"


def _markdown(table: Table) -> str:
    """Return a table as Markdown."""
    lines = [f"## {table.title}", "", _line([*table.heads, *table.columns.values()])]
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
        rows.append(
            PageRow([*map(Cell, (row.of, row.by, row.source)), *numbers], "ours" if row.source in (MEASURED, MEASURED_STAND_IN) else "")
        )
    columns = [*table.heads, *table.columns.values()]
    return {"title": table.title, "columns": columns, "rows": rows, "notes": table.notes}


def formatted(value: float | None) -> str:
    """Return a number in the digits that tables use; a dash for None."""
    if value is None:
        return "–"
    return f"{value:.2e}" if 0 < abs(value) < 1e-3 else f"{value:.3f}" if abs(value) < 1 else f"{value:.2f}"
