# SPDX-License-Identifier: GPL-3.0-or-later
"""Section on skipped work: the time that each rule saves, and the error that it adds."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np
from irgspp.core.evaluation import metrics
from irgspp.core.relight.prepared_light import PreparedLight
from irgspp.core.settings.schema import SkipSettings

from .bench import Bench, Scene
from .reconstruction import COLUMNS, FIGURES, costs
from .runs import RunPlan
from .section import Block, Measurement, Note, Table, Task
from .store import Record, Results
from .studio import RelightVariant, studio
from .timing import medians

NAME = "skipping"
TITLE = "Skipping what a scene does not need"
ABOUT = (
    "Every rule decides by evidence that it measures on the scene (auto), and can be turned off by --set skip.NAME=off. Time saved and "
    "error added are those of auto against off, of the whole job. Where auto decided to skip nothing, both are the same job."
)
ONCE = False
ALL = "all off"
RELIGHTING = ("cache_rays", "reuse_visibility")  # rules of relighting alone
SAVED = ("relight_psnr", "nvs_psnr", "albedo_psnr", "normal_mae")


def rules() -> list[str]:
    """Return the names of the settings in the group `skip`."""
    return [field.name for field in dataclasses.fields(SkipSettings)]


def plans(bench: Bench) -> dict[str, RunPlan]:
    """Return the plans with all rules at auto, with all rules off, and with each rule alone off."""
    found = {"auto": bench.balanced(), ALL: bench.plan("skip-off", *(f"skip.{rule}=off" for rule in rules()), seconds=150)}
    return found | {rule: bench.plan(f"skip-{rule}-off", f"skip.{rule}=off", seconds=130) for rule in rules()}


def tasks(bench: Bench, scene: Scene | None) -> Iterator[Task]:
    """Yield the measurements of a scene: the job at auto, without rules, without each rule alone, and the rules of relighting.

    Args:
        bench: options, scenes and reconstructions.
        scene: scene to measure.
    """
    assert scene is not None
    if not bench.in_detail(scene):
        return
    for configuration, plan in plans(bench).items():
        expected = [plan] if configuration in ("auto", ALL) else []  # only the run at auto shows whether the others are needed
        if configuration not in RELIGHTING:
            yield Task(
                configuration, partial(_measured, bench, scene, configuration), bench.evaluation_seconds, [bench.balanced(), *expected]
            )
    for rule in RELIGHTING if scene.relights else ():
        if rule in rules():
            yield Task(f"{rule}, relighting", partial(_relit, bench, scene, rule), 3.0, [bench.balanced()])


def _measured(bench: Bench, scene: Scene, configuration: str) -> Measurement:
    """Measure the job of a configuration; a rule that auto did not apply needs no job."""
    evidence = evidence_of(bench, scene).get(configuration, {})
    if configuration in rules() and not evidence.get("on"):
        return Measurement({"chosen": "off", "evidence": evidence.get("evidence", "not evaluated in this job")})
    run = bench.run(scene, plans(bench)[configuration])
    evaluated = bench.evaluation(scene, run.path)["figures"]
    figures = {name: evaluated[name] for name in FIGURES if name in evaluated} | costs(run)
    return Measurement({"chosen": "on" if evidence.get("on") else "", "evidence": evidence.get("evidence", ""), **figures})


def _relit(bench: Bench, scene: Scene, rule: str) -> Measurement:
    """Measure a rule of relighting: one view under one light after the other, by both choices in turns."""
    one = studio(bench, scene)
    lights = [lit_view.prepared for lit_view in one.lit_views]
    relighters = {
        choice: one.relighter(RelightVariant(), "efficient", replace(SkipSettings(), **{rule: choice})) for choice in ("auto", "off")
    }
    surfaces = {choice: relighter.surface(one.lit_views[0].view.camera) for choice, relighter in relighters.items()}

    def image(choice: str, light: PreparedLight) -> np.ndarray:
        """Relight the view by a choice, (H, W, 3) on black."""
        return metrics.on_black(relighters[choice].relit(surfaces[choice], light).numpy())

    found = medians({choice: lambda c=choice: [image(c, light) for light in lights] for choice in relighters}, bench.repeats)
    ours, without = (image(choice, lights[0]) for choice in ("auto", "off"))
    limit, inside = one.converged("mesh", 0), one.lit_views[0].inside
    errors = [float(np.sqrt(np.square(p - limit)[inside].mean())) for p in (ours, without)]
    figures = {"frame_seconds": found["auto"] / len(lights), "off_frame_seconds": found["off"] / len(lights)}
    rays = {f"rays_{choice}": relighters[choice].tally["traced"] for choice in relighters}
    figures |= {"rms_error": errors[0], "off_rms_error": errors[1], "difference": float(np.abs(ours - without).max())}
    return Measurement({"chosen": "relighting", **figures}, rays)


def evidence_of(bench: Bench, scene: Scene) -> dict[str, dict[str, Any]]:
    """Return what the job at auto recorded of each rule: whether it is "on", and the "evidence".

    Args:
        bench: options, scenes and reconstructions.
        scene: scene of the job.
    """
    return bench.run(scene, bench.balanced()).about.get("rules", {})


# --- report


def blocks(results: Results) -> Iterator[Block]:
    """Yield the tables of time saved and error added."""
    columns = [name for name in COLUMNS if name in SAVED]
    head = ["scene", "seconds with ↓", "without", "saved", "CPU s with ↓", "without", *(f"{COLUMNS[name]} added" for name in columns)]
    rows = [row for scene in results.scenes if (row := _difference(results, scene, ALL, columns))]
    if rows:
        yield Table("All rules at auto against none", head, rows)
    rows = []
    for scene in results.scenes:
        for record in results.records(scene):
            if record.configuration in ("auto", ALL) or record.figures["chosen"] == "relighting":
                continue
            row = _difference(results, scene, record.configuration, columns)
            evidence = str(record.figures.get("evidence", ""))
            rows.append([_label(record), *(row[1:] if row else [None] * (5 + len(columns))), evidence if row else f"kept: {evidence}"])
    if rows:
        yield Table("Each rule alone", ["rule, " + head[0], *head[1:], "evidence"], sorted(rows, key=lambda row: row[0]))
    relit = [r for r in results.records() if r.figures["chosen"] == "relighting"]
    names = ("frame_seconds", "off_frame_seconds", "rms_error", "off_rms_error", "difference")
    if relit:
        head = ("rule, scene", "frame s with ↓", "without", "error with ↓", "without", "largest difference ↓")
        yield Table(
            "Rules of relighting: one view under one light after the other",
            head,
            [[_label(r), *(r.figures[n] for n in names)] for r in relit],
        )
    if not rules():
        yield Note("This version has no such rules.")


def _label(record: Record) -> str:
    """Return the first cell of a row."""
    return f"{record.configuration}, {record.scene}"


def _difference(results: Results, scene: str, configuration: str, columns: list[str]) -> list[Any] | None:
    """Return scene, seconds at auto and without, fraction saved, and the change of each metric by skipping work."""
    auto, off = (results.get(scene, name) for name in ("auto", configuration))
    if auto is None or off is None or "seconds" not in off.figures:
        return None
    with_it, without = auto.figures["seconds"], off.figures["seconds"]
    changes = [auto.figures[n] - off.figures[n] if n in auto.figures and n in off.figures else None for n in columns]
    cpu = (auto.figures["cpu_seconds"], off.figures["cpu_seconds"])
    return [scene, with_it, without, f"{100 * (1 - with_it / without):.0f} %", *cpu, *(None if c is None else f"{c:+.2f}" for c in changes)]
