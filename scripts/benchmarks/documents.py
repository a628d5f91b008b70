# SPDX-License-Identifier: GPL-3.0-or-later
"""Writer of docs/benchmark.md and of the tables in docs/skipping.md from a benchmark's results."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from types import ModuleType

from irgspp.core.run_folder import write_atomic

from . import charts, summary
from .page import about, engines
from .section import Block, Chart, Images, Note, Table, formatted
from .store import Results, Store

BEGIN, END = "<!-- written by scripts/benchmark.py --write-docs -->", "<!-- end of what is written -->"
HEAD = """# Time against error

Time and error of IRGS++ on rendered scenes with known ground truth. This page is written by

    .venv/bin/python scripts/benchmark.py SCENES -o DIR --write-docs

whose report.html has more plots, and images side by side. Without SCENES it renders two small ones; `--quick` checks in a few minutes
that everything works.
"""
SKIPPING = "# What a scene does not need\n"


def write(store: Store, sections: Sequence[ModuleType], folder: Path) -> None:
    """Write docs/benchmark.md with its plots, and the tables of docs/skipping.md.

    Args:
        store: records of all measurements
        sections: modules of the sections, in the order of their chapters
        folder: folder of the documents
    """
    parts = []
    for section in sections:
        results = Results(store, section.NAME)
        if not results.scenes:
            continue
        blocks = [block for block in section.blocks(results) if not isinstance(block, Images)]
        if section.NAME == "skipping":
            _between(folder / "skipping.md", "\n\n".join(text for block in blocks if (text := _block(block, folder))))
        chapter = [f"## {section.TITLE}", section.ABOUT, engines(store, section), *(_block(block, folder) for block in blocks)]
        parts.append("\n\n".join(text for text in chapter if text))
    short = [_block(block, folder) for block in summary.blocks(store)]
    text = "\n\n".join([HEAD.rstrip(), *about(store), *short, *parts, *_failed(store)])
    write_atomic(folder / "benchmark.md", (text + "\n").encode())


def _failed(store: Store) -> list[str]:
    """Return the list of failed measurements, as a chapter or nothing."""
    lines = [f"- {' '.join(record.key)}: {record.error}" for record in store.records.values() if record.status == "failed"]
    return ["## What failed\n\n" + "\n".join(lines)] if lines else []


def _block(block: Block, folder: Path) -> str:
    """Return a block as Markdown; "" for what only the report shows."""
    if isinstance(block, Note):
        return block.text
    if isinstance(block, Table):
        return "" if block.detail else f"**{block.title}**\n\n{_table(block)}"
    if isinstance(block, Chart) and block.image:
        charts.png(block, folder / "pictures" / f"{block.image}.png")
        return f"![{block.title}](pictures/{block.image}.png)"
    return ""


def _table(table: Table) -> str:
    """Return a table as Markdown."""
    rows = [[str(name) for name in table.columns], *([formatted(value) for value in row] for row in table.rows)]
    rule = ["---", *("---:" for _ in table.columns[1:])]
    return "\n".join("| " + " | ".join(cell.replace("|", "\\|") for cell in row) + " |" for row in [rows[0], rule, *rows[1:]])


def _between(path: Path, text: str) -> None:
    """Replace the text between the two marks of a page; append the marks and the text where there are none."""
    page = path.read_text(encoding="utf-8") if path.is_file() else SKIPPING
    if BEGIN not in page:
        page = f"{page.rstrip()}\n\n{BEGIN}\n{END}\n"
    before, _, rest = page.partition(BEGIN)
    write_atomic(path, f"{before}{BEGIN}\n\n{text}\n\n{END}{rest.partition(END)[2]}".encode())
