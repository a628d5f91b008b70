# SPDX-License-Identifier: GPL-3.0-or-later
"""Runner of the cases of scripts/stress.py and scripts/faults.py: choice by options, table, JSON and HTML report."""

from __future__ import annotations

import argparse
import json
import platform
import sys
import textwrap
import time
from collections.abc import Sequence
from pathlib import Path

import numba
import numpy
import torch
from irgspp.core.machine.thread_pool import thread_count
from reports.pages import Cell, Row, render

from .case import Case, Outcome, attempt

HEAD = ("case", "what must hold", "measured", "verdict", "s")
WIDTHS = (34, 50, 58, 7, 6)


def examine(cases: Sequence[Case], stem: str, title: str, arguments: Sequence[str] | None) -> int:
    """Run the chosen cases and report them.

    Args:
        cases: all cases.
        stem: name of the command and of the report's files.
        title: title of the report.
        arguments: options of the command line; None: those of the process.

    Returns:
        The exit status.
    """
    options = parsed(arguments, stem, title)
    chosen = selected(cases, options.quick, options.only)
    if not chosen:
        print(f"{stem}: no case has {options.only!r} in its name", file=sys.stderr)
        return 2
    outcomes = run(chosen)
    print(table(outcomes))
    if options.output is not None:
        write(options.output, outcomes, stem, title)
    return 0 if all(outcome.passed for outcome in outcomes) else 1


def parsed(arguments: Sequence[str] | None, stem: str, title: str) -> argparse.Namespace:
    """Parse the command line.

    Args:
        arguments: options; None: those of the process.
        stem: name of the report's files.
        title: title of the report.
    """
    parser = argparse.ArgumentParser(description=title)
    parser.add_argument("--quick", action="store_true", help="only the cases that take seconds")
    parser.add_argument("--only", metavar="TEXT", default="", help="only cases with this in their group or name")
    parser.add_argument("-o", "--output", type=Path, metavar="DIR", help=f"also write {stem}.json and {stem}.html there")
    return parser.parse_args(arguments)


def selected(cases: Sequence[Case], quick: bool, only: str) -> list[Case]:
    """Return the chosen cases in the order they were registered.

    Args:
        cases: all cases.
        quick: True for the quick cases alone.
        only: text in the group or name; "" for all.
    """
    return [case for case in cases if (case.quick or not quick) and only.lower() in f"{case.group}: {case.name}".lower()]


def run(cases: Sequence[Case]) -> list[Outcome]:
    """Run cases one after the other and print a line on stderr for each."""
    outcomes = []
    for case in cases:
        outcomes.append(attempt(case))
        print(f"{verdict(outcomes[-1]):>6} {outcomes[-1].seconds:6.1f} s  {case.group}: {case.name}", file=sys.stderr, flush=True)
    return outcomes


def verdict(outcome: Outcome) -> str:
    """Return the result of a case in one word."""
    return "holds" if outcome.passed else "FAILS"


def cells(outcome: Outcome) -> tuple[str, str, str, str, str]:
    """Return a case's row of the table."""
    case = outcome.case
    return f"{case.group}: {case.name}", case.holds, "; ".join(outcome.figures), verdict(outcome), f"{outcome.seconds:.1f}"


def table(outcomes: Sequence[Outcome]) -> str:
    """Return the table for a terminal, with wrapped cells, a summary and the faults."""
    rule = "-+-".join("-" * width for width in WIDTHS)
    lines = [_row(HEAD), rule]
    for outcome in outcomes:
        lines += [_row(cells(outcome)), rule]
    failed = [outcome for outcome in outcomes if not outcome.passed]
    lines.append(f"{len(outcomes) - len(failed)} of {len(outcomes)} cases hold, {sum(o.seconds for o in outcomes):.0f} s")
    lines += [f"FAILS {o.case.group}: {o.case.name}: {fault}" for o in failed for fault in o.faults]
    return "\n".join(lines)


def _row(texts: Sequence[str]) -> str:
    """Return a row of wrapped cells."""
    columns = [_wrapped(text, width) for text, width in zip(texts, WIDTHS, strict=True)]
    height = max(map(len, columns))
    padded = [column + [""] * (height - len(column)) for column in columns]
    lines = [" | ".join(part.ljust(width) for part, width in zip(line, WIDTHS, strict=True)) for line in zip(*padded, strict=True)]
    return "\n".join(line.rstrip() for line in lines)


def _wrapped(text: str, width: int) -> list[str]:
    """Return the lines of a wrapped cell."""
    return textwrap.wrap(text, width) or [""]


def about() -> dict[str, str | int]:
    """Return the machine and the versions that results depend on."""
    versions = {"python": platform.python_version(), "numpy": numpy.__version__, "torch": torch.__version__, "numba": numba.__version__}
    return {"machine": platform.machine(), "system": platform.system(), "threads": thread_count(), **versions}


def write(folder: Path, outcomes: Sequence[Outcome], stem: str, title: str) -> None:
    """Write the report as `stem`.json and `stem`.html.

    Args:
        folder: folder to make.
        outcomes: outcomes in the order they were run.
        stem: name of the files.
        title: title of the report.
    """
    folder.mkdir(parents=True, exist_ok=True)
    records = [
        {
            "group": o.case.group,
            "case": o.case.name,
            "holds": o.case.holds,
            "quick": o.case.quick,
            "measured": o.figures,
            "faults": o.faults,
            "passed": o.passed,
            "seconds": round(o.seconds, 3),
        }
        for o in outcomes
    ]
    report = {"about": about(), "when": time.strftime("%Y-%m-%d %H:%M:%S"), "cases": records}
    (folder / f"{stem}.json").write_text(json.dumps(report, indent=1) + "\n", encoding="utf-8")
    (folder / f"{stem}.html").write_text(page(outcomes, title), encoding="utf-8")
    print(f"{folder / f'{stem}.html'}")


def page(outcomes: Sequence[Outcome], title: str) -> str:
    """Return the report as HTML text, with a table for each group.

    Args:
        outcomes: outcomes in the order they were run.
        title: title and heading of the page.
    """
    groups = []
    for name in dict.fromkeys(o.case.group for o in outcomes):
        rows = [Row([*map(Cell, (o.case.name, *cells(o)[1:]))], verdict(o).lower()) for o in outcomes if o.case.group == name]
        groups.append({"title": name.capitalize(), "rows": rows})
    facts = ", ".join(f"{key} {value}" for key, value in about().items())
    passed = sum(o.passed for o in outcomes)
    return render("cases", title=title, passed=passed, count=len(outcomes), facts=facts, columns=HEAD, groups=groups)
