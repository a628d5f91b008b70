# SPDX-License-Identifier: GPL-3.0-or-later
"""What a scene does not need: each rule that leaves work out, with it and without."""

# pyright: reportMissingImports=false
# (`irgspp` is the folder above, known to pyright under no name)

from __future__ import annotations

import dataclasses
from collections.abc import Iterator
from functools import partial
from typing import Any

from irgspp.core.config import SkipSettings

from .bench import Bench, Scene
from .reconstruction import COLUMNS, FIGURES, costs
from .runs import RunPlan
from .section import Block, Measurement, Note, Table, Task
from .store import Results

NAME = "skipping"
TITLE = "Skipping what a scene does not need"
ABOUT = (
    "Every rule decides by evidence that it measures on the scene (auto), and can be turned off: `--set skip.NAME=off`. Time saved and "
    "error added are those of auto against off; figures are of the whole job. Where auto chose to leave nothing out, both are the same job."
)
ONCE = False
ALL = "all off"
SAVED = ("relight_psnr", "nvs_psnr", "albedo_psnr", "normal_mae")


def rules() -> list[str]:
    """Names of the settings in the group `skip`."""
    return [field.name for field in dataclasses.fields(SkipSettings)]


def plans(bench: Bench) -> dict[str, RunPlan]:
    """All rules at auto, none, and each alone off."""
    found = {"auto": bench.balanced(), ALL: bench.plan("skip-off", *(f"skip.{rule}=off" for rule in rules()), seconds=150)}
    return found | {rule: bench.plan(f"skip-{rule}-off", f"skip.{rule}=off", seconds=130) for rule in rules()}


def tasks(bench: Bench, scene: Scene | None) -> Iterator[Task]:
    assert scene is not None
    for configuration, plan in plans(bench).items():
        expected = [plan] if configuration in ("auto", ALL) else []  # whether the others are needed, only the run at auto tells
        yield Task(configuration, partial(_measured, bench, scene, configuration), bench.evaluation_seconds, [bench.balanced(), *expected])


def _measured(bench: Bench, scene: Scene, configuration: str) -> Measurement:
    evidence = evidence_of(bench, scene).get(configuration, {})
    if configuration in rules() and evidence.get("chosen") != "on":
        return Measurement({"chosen": "off", "evidence": evidence.get("evidence", "not asked in this job")})
    run = bench.run(scene, plans(bench)[configuration])
    evaluated = bench.evaluation(scene, run.path)["figures"]
    figures = {name: evaluated[name] for name in FIGURES if name in evaluated} | costs(run)
    return Measurement({"chosen": evidence.get("chosen", ""), "evidence": evidence.get("evidence", ""), **figures})


def evidence_of(bench: Bench, scene: Scene) -> dict[str, dict[str, Any]]:
    """What the job at auto wrote of each rule."""
    return {entry["rule"]: entry for entry in bench.run(scene, bench.balanced()).about["skipped"] if "rule" in entry}


# --- what is shown


def blocks(results: Results) -> Iterator[Block]:
    columns = [name for name in COLUMNS if name in SAVED]
    head = ["scene", "seconds with ↓", "without", "saved", *(f"{COLUMNS[name]} added" for name in columns)]
    rows = [row for scene in results.scenes if (row := _difference(results, scene, ALL, columns))]
    if rows:
        yield Table("All rules at auto against none", head, rows)
    rows = []
    for scene in results.scenes:
        for record in results.records(scene):
            if record.configuration in ("auto", ALL):
                continue
            row = _difference(results, scene, record.configuration, columns)
            label = f"{record.configuration}, {scene}"
            evidence = str(record.figures.get("evidence", ""))
            rows.append([label, *(row[1:] if row else [None] * (3 + len(columns))), evidence if row else f"kept: {evidence}"])
    if rows:
        yield Table("Each rule alone", ["rule, " + head[0], *head[1:], "evidence"], sorted(rows, key=lambda row: row[0]))
    elif not rules():
        yield Note("There are no such rules in this version.")


def _difference(results: Results, scene: str, configuration: str, columns: list[str]) -> list[Any] | None:
    """Scene, seconds at auto, seconds without, share saved, and how much each figure is changed by leaving work out."""
    auto, off = (results.get(scene, name) for name in ("auto", configuration))
    if auto is None or off is None or "seconds" not in off.figures:
        return None
    with_it, without = auto.figures["seconds"], off.figures["seconds"]
    changes = [auto.figures[n] - off.figures[n] if n in auto.figures and n in off.figures else None for n in columns]
    return [scene, with_it, without, f"{100 * (1 - with_it / without):.0f} %", *(None if c is None else f"{c:+.2f}" for c in changes)]
