# SPDX-License-Identifier: GPL-3.0-or-later
"""The report: one HTML file with every table, plot and image inside."""

from __future__ import annotations

import base64
import io
from collections.abc import Iterator, Sequence
from html import escape
from pathlib import Path
from types import ModuleType

from irgspp.core.run_folder import write_atomic
from PIL import Image

from . import charts, summary
from .section import Block, Chart, Note, Table, shown
from .store import Results, Store

LONGEST = 1600  # pixels of an image that is shown
STYLE = """
body { font: 15px/1.5 system-ui, sans-serif; margin: 0 auto; max-width: 1380px; padding: 1.5rem; background: #18191c; color: #e2e2de }
h1 { font-size: 1.7rem; margin: 0 0 .3rem }
h2 { font-size: 1.3rem; margin: 3rem 0 .2rem; border-top: 1px solid #3a3c42; padding-top: 1.2rem }
h3 { font-size: 1rem; margin: 1.6rem 0 .4rem } p { color: #b4b4ae; max-width: 62rem; margin: .4rem 0 } a { color: #f2a33a }
nav { margin: 1rem 0 } nav a { margin-right: 1.1rem; text-decoration: none }
table { border-collapse: collapse; font-size: .92rem } th { color: #a9a9a4; font-weight: 500; text-align: right; vertical-align: bottom }
td, th { padding: .22rem .8rem .22rem 0; border-bottom: 1px solid #2c2e33 } td { font-variant-numeric: tabular-nums; text-align: right }
td:first-child, th:first-child, td.text { text-align: left } tr:hover td { background: #212328 }
svg { max-width: 100%; height: auto; display: block } .scroll { overflow-x: auto }
.row { display: flex; flex-wrap: wrap; gap: 8px; margin-bottom: 10px }
figure { margin: 0; flex: 0 1 calc((100% - 40px) / 6); min-width: 130px }
figure img { width: 100%; display: block; border-radius: 3px } figcaption { font-size: .8rem; color: #a9a9a4; padding-top: 2px }
.failed { color: #e8718d }
"""


def write(store: Store, sections: Sequence[ModuleType]) -> Path:
    """Make report.html of the store's folder; returns its path."""
    parts = [(section, list(section.blocks(results))) for section in sections if (results := Results(store, section.NAME)).scenes]
    links = "".join(f"<a href='#{section.NAME}'>{escape(section.TITLE)}</a>" for section, _ in parts)
    short = "".join(_block(store.folder, block) for block in summary.blocks(store))
    chapters = "".join(_chapter(store, section, blocks) for section, blocks in parts)
    text = (
        f"<!doctype html><html lang='en'><meta charset='utf-8'><title>IRGS++ benchmark</title><style>{STYLE}</style>"
        f"<h1>IRGS++: time against error</h1>{''.join(f'<p>{escape(line)}</p>' for line in about(store))}"
        f"<nav>{links}</nav>{short}{_failures(store)}{chapters}</html>\n"
    )
    path = store.folder / "report.html"
    write_atomic(path, text.encode())
    return path


def about(store: Store) -> Iterator[str]:
    """On what it was measured, and how seconds are to be read; a line each."""
    used = [store.environments[name] for name in dict.fromkeys(r.environment for r in store.records.values()) if name in store.environments]
    for machine in used:
        versions = ", ".join(f"{name} {number}" for name, number in machine["versions"].items() if name != "platform")
        cpu = f"{machine['cpu']}, {machine['threads']} threads ({' '.join(machine['simd'])})"
        yield f"Machine: {cpu}; {machine['versions'].get('platform', '')}. Versions: {versions}."
    scenes = [f"{name} ({'glossy' if known['glossy'] else 'low-gloss'}, {known['size']} px)" for name, known in store.scenes.items()]
    yield f"Scenes: {', '.join(scenes)}. Images are compared sRGB-encoded, clipped to 0..1, on black; PSNR in dB."
    yield "↑: more is better, ↓: less is. Seconds are wall clock, medians of repeats; compare them within this report alone."


def engines(store: Store, section: ModuleType) -> str:
    """Which states of the engine a section was measured on, where not all were on one; else nothing."""
    sources: dict[str, set[str]] = {}
    for record in store.records.values():
        machine = store.environments.get(record.environment, {"versions": {}})
        sources.setdefault(record.section, set()).add(machine["versions"].get("engine's source", "unknown"))
    if len(set.union(set(), *sources.values())) < 2:
        return ""
    return f"Measured on the engine of source {', '.join(sorted(sources[section.NAME]))}."


def _chapter(store: Store, section: ModuleType, blocks: Sequence[Block]) -> str:
    content = "".join(_block(store.folder, block) for block in blocks)
    about = f"{section.ABOUT} {engines(store, section)}".strip()
    return f"<h2 id='{section.NAME}'>{escape(section.TITLE)}</h2><p>{escape(about)}</p>{content}"


def _failures(store: Store) -> str:
    failed = [record for record in store.records.values() if record.status == "failed"]
    lines = "".join(f"<p class='failed'>{escape(' '.join(record.key))}: {escape(record.error)}</p>" for record in failed)
    return f"<h3>What failed</h3>{lines}" if failed else ""


def _block(folder: Path, block: Block) -> str:
    if isinstance(block, Note):
        return f"<p>{escape(block.text)}</p>"
    title = f"<h3>{escape(block.title)}</h3>"
    if isinstance(block, Table):
        return f"{title}<div class='scroll'>{_table(block)}</div>"
    if isinstance(block, Chart):
        return f"{title}{charts.svg(block)}"
    return title + "".join(f"<div class='row'>{''.join(_figure(folder, *one) for one in row)}</div>" for row in block.rows)


def _table(table: Table) -> str:
    head = "".join(f"<th>{escape(name)}</th>" for name in table.columns)
    rows = "".join(f"<tr>{''.join(_cell(value) for value in row)}</tr>" for row in table.rows)
    return f"<table><tr>{head}</tr>{rows}</table>"


def _cell(value: str | float | int | None) -> str:
    return f"<td class='text'>{escape(value)}</td>" if isinstance(value, str) else f"<td>{shown(value)}</td>"


def _figure(folder: Path, caption: str, file: str) -> str:
    """An image with its bytes inside; without it, where the file is gone."""
    if not (folder / file).is_file():
        return ""
    with Image.open(folder / file) as file:
        image = file.convert("RGB")
    image.thumbnail((LONGEST, LONGEST), Image.Resampling.LANCZOS)
    data = io.BytesIO()
    image.save(data, "JPEG", quality=92, subsampling=0)
    source = base64.b64encode(data.getvalue()).decode()
    return f"<figure><img alt='{escape(caption)}' src='data:image/jpeg;base64,{source}'><figcaption>{escape(caption)}</figcaption></figure>"
