# SPDX-License-Identifier: GPL-3.0-or-later
"""The numerical stress test: what no input may break, case by case, as a table, JSON and a page.

    .venv/bin/python scripts/stress.py --quick            # the cases that are part of the test suite
    .venv/bin/python scripts/stress.py -o stress          # all of them, with 20,000 iterations and millions of triangles

Exit status: 0 every case holds, 1 one does not, 2 bad usage.
"""

from __future__ import annotations

import argparse
import html
import importlib
import json
import os
import platform
import sys
import textwrap
import time
from collections.abc import Sequence
from pathlib import Path

os.environ.setdefault("OMP_WAIT_POLICY", "PASSIVE")  # as the engine does: waiting threads must not take the cores from working ones

import numba
import numpy
import torch
from irgspp.core.machine.thread_pool import thread_count
from stresses.case import CASES, Case, Outcome, attempt

GROUPS = ("gaussians", "materials", "lights", "training", "endurance", "surfaces")
HEAD = ("case", "what must hold", "measured", "verdict", "s")
WIDTHS = (34, 50, 58, 7, 6)
STYLE = """body{font:14px/1.45 system-ui,sans-serif;max-width:1250px;margin:2em auto;padding:0 1em;color:#222}
table{border-collapse:collapse;width:100%}td,th{border-bottom:1px solid #ddd;padding:.35em .7em;text-align:left;vertical-align:top}
h2{margin:1.4em 0 .3em}.fails{background:#fdd}.fails td:nth-child(4){font-weight:bold;color:#a00}
td:nth-child(4),td:nth-child(5){white-space:nowrap}
td:nth-child(1){width:17%}td:nth-child(2){width:36%}"""


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the chosen cases and report; returns the exit status."""
    for name in GROUPS:
        importlib.import_module(f"stresses.{name}")
    return examine(CASES, "stress", "Numerical stress test", arguments)


def examine(cases: Sequence[Case], stem: str, title: str, arguments: Sequence[str] | None) -> int:
    """Run those of the cases that the arguments choose and report under a name and a title; returns the exit status."""
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
    parser = argparse.ArgumentParser(description=title)
    parser.add_argument("--quick", action="store_true", help="only the cases that take seconds")
    parser.add_argument("--only", metavar="TEXT", default="", help="only cases with this in their group or name")
    parser.add_argument("-o", "--output", type=Path, metavar="DIR", help=f"also write {stem}.json and {stem}.html there")
    return parser.parse_args(arguments)


def selected(cases: Sequence[Case], quick: bool, only: str) -> list[Case]:
    """The cases asked for, in the order they were registered."""
    return [case for case in cases if (case.quick or not quick) and only.lower() in f"{case.group}: {case.name}".lower()]


def run(cases: Sequence[Case]) -> list[Outcome]:
    """All of them, one after the other, each told on stderr as it ends."""
    outcomes = []
    for case in cases:
        outcomes.append(attempt(case))
        print(f"{verdict(outcomes[-1]):>6} {outcomes[-1].seconds:6.1f} s  {case.group}: {case.name}", file=sys.stderr, flush=True)
    return outcomes


def verdict(outcome: Outcome) -> str:
    """One word."""
    return "holds" if outcome.passed else "FAILS"


def cells(outcome: Outcome) -> tuple[str, str, str, str, str]:
    """A row of the table."""
    case = outcome.case
    return f"{case.group}: {case.name}", case.holds, "; ".join(outcome.figures), verdict(outcome), f"{outcome.seconds:.1f}"


def table(outcomes: Sequence[Outcome]) -> str:
    """The table for a terminal, long cells wrapped, and a line that sums it up."""
    rule = "-+-".join("-" * width for width in WIDTHS)
    lines = [_row(HEAD), rule]
    for outcome in outcomes:
        lines += [_row(cells(outcome)), rule]
    failed = [outcome for outcome in outcomes if not outcome.passed]
    lines.append(f"{len(outcomes) - len(failed)} of {len(outcomes)} cases hold, {sum(o.seconds for o in outcomes):.0f} s")
    lines += [f"FAILS {o.case.group}: {o.case.name}: {fault}" for o in failed for fault in o.faults]
    return "\n".join(lines)


def _row(texts: Sequence[str]) -> str:
    columns = [_wrapped(text, width) for text, width in zip(texts, WIDTHS, strict=True)]
    height = max(map(len, columns))
    padded = [column + [""] * (height - len(column)) for column in columns]
    lines = [" | ".join(part.ljust(width) for part, width in zip(line, WIDTHS, strict=True)) for line in zip(*padded, strict=True)]
    return "\n".join(line.rstrip() for line in lines)


def _wrapped(text: str, width: int) -> list[str]:
    return textwrap.wrap(text, width) or [""]


def about() -> dict[str, str | int]:
    """The machine and the versions that figures depend on."""
    versions = {"python": platform.python_version(), "numpy": numpy.__version__, "torch": torch.__version__, "numba": numba.__version__}
    return {"machine": platform.machine(), "system": platform.system(), "threads": thread_count(), **versions}


def write(folder: Path, outcomes: Sequence[Outcome], stem: str, title: str) -> None:
    """Report as `stem`.json and `stem`.html into `folder`."""
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
    """The table as a page, a heading for each group."""
    passed, parts = sum(o.passed for o in outcomes), []
    for name in dict.fromkeys(o.case.group for o in outcomes):
        parts.append(f"<h2>{html.escape(name.capitalize())}</h2>\n<table><tr>{''.join(f'<th>{h}</th>' for h in HEAD)}</tr>")
        for outcome in (o for o in outcomes if o.case.group == name):
            _, *rest = cells(outcome)
            row = "".join(f"<td>{html.escape(text)}</td>" for text in (outcome.case.name, *rest))
            parts.append(f'<tr class="{verdict(outcome).lower()}">{row}</tr>')
        parts.append("</table>")
    facts = ", ".join(f"{key} {value}" for key, value in about().items())
    head = f"<h1>{title}</h1><p>{passed} of {len(outcomes)} cases hold. {html.escape(facts)}.</p>"
    style = f"<meta charset='utf-8'><title>{title}</title><style>{STYLE}</style>"
    return f"<!doctype html>\n<html lang='en'><head>{style}</head><body>{head}\n{''.join(chr(10) + p for p in parts)}\n</body></html>\n"


if __name__ == "__main__":
    sys.exit(main())
