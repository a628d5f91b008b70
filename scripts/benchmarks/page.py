# SPDX-License-Identifier: GPL-3.0-or-later
"""HTML report of the benchmark: one file with every table, chart and image inside."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path
from types import ModuleType
from typing import Any

from irgspp.core.run_folder import write_atomic
from reports.pages import Cell, Row, embedded_jpeg, render

from . import charts, summary
from .section import Block, Chart, Note, Table, formatted
from .store import Results, Store

LONGEST = 1600  # pixels of an image's longer side in the report


def write(store: Store, sections: Sequence[ModuleType]) -> Path:
    """Write report.html into the store's folder.

    Args:
        store: records of all measurements.
        sections: modules of the sections, in the order of their chapters; those without records get no chapter.

    Returns:
        The path of the page.
    """
    values = {
        "title": "IRGS++ benchmark",
        "about": list(about(store)),
        "summary": [_part(store.folder, block) for block in summary.blocks(store)],
        "failures": [f"{' '.join(r.key)}: {r.error}" for r in store.records.values() if r.status == "failed"],
        "chapters": [_chapter(store, section, results) for section in sections if (results := Results(store, section.NAME)).scenes],
    }
    path = store.folder / "report.html"
    write_atomic(path, render("benchmark", **values).encode())
    return path


def about(store: Store) -> Iterator[str]:
    """Yield the lines that say which machines and scenes the results are of, and how to read seconds and arrows."""
    used = [store.environments[name] for name in dict.fromkeys(r.environment for r in store.records.values()) if name in store.environments]
    for machine in used:
        versions = ", ".join(f"{name} {number}" for name, number in machine["versions"].items() if name != "platform")
        cpu = f"{machine['cpu']}, {machine['threads']} threads ({' '.join(machine['simd'])})"
        yield f"Machine: {cpu}; {machine['versions'].get('platform', '')}. Versions: {versions}."
    scenes = [f"{name} ({'glossy' if known['glossy'] else 'low-gloss'}, {known['size']} px)" for name, known in store.scenes.items()]
    yield f"Scenes: {', '.join(scenes)}. Images are compared sRGB-encoded, clipped to 0..1, on black; PSNR in dB."
    yield "↑: more is better, ↓: less is. Seconds are wall clock, medians of repeats; compare them within this report alone."


def engines(store: Store, section: ModuleType) -> str:
    """Return a sentence with the versions of the engine's source that a section was measured on.

    Args:
        store: records of all measurements.
        section: module of the section.

    Returns:
        The sentence; "" where all sections were measured on one version.
    """
    sources: dict[str, set[str]] = {}
    for record in store.records.values():
        machine = store.environments.get(record.environment, {"versions": {}})
        sources.setdefault(record.section, set()).add(machine["versions"].get("engine's source", "unknown"))
    if len(set.union(set(), *sources.values())) < 2:
        return ""
    return f"Measured on the engine of source {', '.join(sorted(sources[section.NAME]))}."


def _chapter(store: Store, section: ModuleType, results: Results) -> dict[str, Any]:
    """Return a section's chapter as the template takes it."""
    text = f"{section.ABOUT} {engines(store, section)}".strip()
    parts = [_part(store.folder, block) for block in section.blocks(results)]
    return {"name": section.NAME, "title": section.TITLE, "about": text, "blocks": parts}


def _part(folder: Path, block: Block) -> dict[str, Any]:
    """Return a block as the template takes it; images whose files are gone are left out."""
    if isinstance(block, Note):
        return {"kind": "note", "title": "", "text": block.text}
    if isinstance(block, Table):
        rows = [Row([Cell(formatted(value), isinstance(value, str)) for value in row]) for row in block.rows]
        return {"kind": "table", "title": block.title, "columns": block.columns, "rows": rows}
    if isinstance(block, Chart):
        return {"kind": "chart", "title": block.title, "svg": charts.svg(block)}
    files = [[(caption, folder / file) for caption, file in row if (folder / file).is_file()] for row in block.rows]
    jpegs = [[(caption, embedded_jpeg(file, LONGEST, quality=92, subsampling=0)) for caption, file in row] for row in files]
    return {"kind": "images", "title": block.title, "rows": jpegs}
