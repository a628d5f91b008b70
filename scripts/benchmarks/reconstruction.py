# SPDX-License-Identifier: GPL-3.0-or-later
"""Section on reconstruction: quality over time, the effect of each part of the method, and the paper's headline."""

from __future__ import annotations

import shutil
from collections.abc import Iterator
from functools import partial
from typing import Any

import numpy as np
from irgspp.core.evaluation import metrics, visualisation
from irgspp.core.relight.backends import best_backend
from irgspp.core.scene.gaussians import load_gaussians

from . import irgs_baseline
from .bench import PRESETS, Bench, Scene
from .runs import Run, RunPlan
from .section import Block, Chart, Figures, Images, Measurement, Note, Series, Table, Task
from .store import Results
from .studio import RelightVariant, studio

NAME = "reconstruction"
TITLE = "Reconstruction: error against time"
ABOUT = (
    "The whole job, from photographs to a textured mesh; every run is an irgspp reconstruct of its own, compared with held-back views. "
    "NVS: views under the photographs' own light, rendered by recovered light and materials; relit: under other lights, with one scale of "
    "the albedo per channel. Seconds: wall clock of all phases. All scenes by both presets; the effect of single parts, "
    "time budgets and IRGS on the first low-gloss and the first glossy scene."
)
ONCE = False
FIGURES = ("relight_psnr", "nvs_psnr", "albedo_psnr", "normal_mae", "roughness_mae", "metallic_mae", "environment_psnr", "radiance_psnr")
COLUMNS = {
    "relight_psnr": "relit dB ↑",
    "nvs_psnr": "NVS dB ↑",
    "albedo_psnr": "albedo dB ↑",
    "environment_psnr": "light dB ↑",
    "normal_mae": "normals ° ↓",
    "roughness_mae": "roughness ↓",
    "metallic_mae": "metallic ↓",
}
BUDGETED = "balanced"  # preset that gets time budgets
NOTICED = 0.1  # dB that a longer time must lose to be reported
# Effect of one part: title, then the configurations that are compared.
PARTS = {
    "Indirect light traced through the Gaussians (2DGRT) in training": ("balanced", "without indirect light"),
    "Stages": ("balanced", "first stage alone"),
    "Reflections in the first stage": ("balanced", "without reflections"),
}
HEADLINE = {  # IRGS, and IRGS++ twice: plan of the run, variant and samples of relighting
    irgs_baseline.NAME: (irgs_baseline.NAME, irgs_baseline.RELIT, irgs_baseline.RELIT_SAMPLES),
    "IRGS++ HQ": ("balanced", RelightVariant("mesh"), "hq"),
    "IRGS++ efficient": ("balanced", RelightVariant("mesh"), "efficient"),
}


def plans(bench: Bench, scene: Scene) -> dict[str, RunPlan]:
    """Return the plans of a scene's runs by configuration; those beyond the presets on the scenes in detail alone.

    Args:
        bench: options, scenes and reconstructions.
        scene: scene to reconstruct.
    """
    found = {preset: bench.plan(preset, preset=preset) for preset in bench.presets}
    if not bench.in_detail(scene):
        return found
    found["without indirect light"] = bench.plan("no-indirect", "second.indirect=off", seconds=115)
    if scene.glossy:
        found["without reflections"] = bench.plan("no-reflections", materials="low-gloss")
    found[irgs_baseline.NAME] = bench.plan("irgs", *irgs_baseline.OPTIONS, seconds=250)
    return found | {f"{BUDGETED}, {minutes:g} min": _budget(bench, minutes) for minutes in bench.budgets}


def _budget(bench: Bench, minutes: float) -> RunPlan:
    """Return the plan of a job with a time budget."""
    seconds = max(1, round(60 * minutes))
    text = f"{seconds // 60}m" if seconds % 60 == 0 else f"{seconds}s"
    return bench.plan(f"{BUDGETED}-{text}", preset=BUDGETED, time=text, seconds=seconds)


def tasks(bench: Bench, scene: Scene | None) -> Iterator[Task]:
    """Yield the measurements of a scene: all plans, the first stage alone, and the paper's headline.

    Args:
        bench: options, scenes and reconstructions.
        scene: scene to measure.
    """
    assert scene is not None
    for configuration, plan in plans(bench, scene).items():
        yield Task(configuration, partial(_quality, bench, scene, plan), bench.evaluation_seconds, [plan])
    if not bench.in_detail(scene):
        return
    yield Task("first stage alone", partial(_first, bench, scene), 2 * bench.evaluation_seconds, [bench.balanced()])
    if scene.relights:
        for name, (configuration, variant, samples) in HEADLINE.items():
            plan = plans(bench, scene)[configuration]
            yield Task(f"headline, {name}", partial(_headline, bench, scene, plan, variant, samples), bench.evaluation_seconds, [plan])


def _quality(bench: Bench, scene: Scene, plan: RunPlan) -> Measurement:
    """Measure the evaluation's metrics and the costs of a plan's run."""
    run = bench.run(scene, plan)
    evaluated = bench.evaluation(scene, run.path)["figures"]
    return Measurement(_figures(evaluated) | costs(run), {"gaussians": _gaussians(run)})


def costs(run: Run) -> Figures:
    """Return seconds, memory and skipped work of a run."""
    about = run.about
    skipped = [name for name, rule in about.get("rules", {}).items() if rule["on"]]
    phases = {f"{name.replace(' ', '_')}_seconds": seconds for name, seconds in run.phase_seconds().items()}
    total = {"seconds": run.seconds, "cpu_seconds": run.cpu_seconds, "peak_memory_bytes": run.peak_memory}
    return {**total, **phases, "skipped": ", ".join(map(str, skipped))}


def _gaussians(run: Run) -> int:
    """Return the number of Gaussians of a run."""
    return load_gaussians(run.path / "gaussians.ply").count


def _figures(evaluated: dict[str, Any]) -> Figures:
    """Return those metrics of an evaluation that the section reports."""
    names = (*FIGURES, "relight_ssim", "nvs_ssim", "albedo_ssim", "environment_ssim", "mesh_chamfer")
    return {name: evaluated[name] for name in names if name in evaluated}


def _first(bench: Bench, scene: Scene) -> Measurement:
    """Measure the first stage's own materials and light, relit through its Gaussians, because it has no mesh."""
    run = bench.run(scene, bench.balanced())
    if not (run.first / "reconstruction.json").is_file():
        raise RuntimeError(f"{run.first} is missing: the result of the first stage was not copied")
    for name in ("cameras.json", "run.json"):  # which the job writes after its first stage, and the evaluation reads
        shutil.copyfile(run.path / name, run.first / name)
    evaluated = bench.evaluation(scene, run.first, settings_of=run.path)["figures"]
    seconds = run.phase_seconds()
    return Measurement(_figures(evaluated) | {"seconds": seconds["read"] + seconds["first stage"]})


def _headline(bench: Bench, scene: Scene, plan: RunPlan, variant: RelightVariant, samples: str | int) -> Measurement:
    """Measure the error against the true relit images of a few views, with the albedo scale that all views give, and the frame rate."""
    run = bench.run(scene, plan)
    scale, one = bench.evaluation(scene, run.path)["albedo_scale"], studio(bench, scene, run.path)
    relighter = one.relighter(variant, samples).with_albedo_scale(scale)
    rows, shown = [], {}
    for lit_view in one.lit_views:
        ours = metrics.on_black(relighter.relit(relighter.surface(lit_view.view.camera), lit_view.prepared).numpy())
        rows.append((metrics.psnr(ours, lit_view.true), metrics.ssim(ours, lit_view.true)))
        if not shown:
            error = visualisation.heat(np.abs(ours - lit_view.true).max(-1), 0.2)[..., :3]
            shown = {"true": lit_view.true, "ours": ours, "error to 0.2": error}
    seconds, turned = one.seconds(variant, samples, bench.repeats), one.turned_seconds(variant, samples, bench.repeats)
    psnr, ssim = np.mean(rows, 0)
    figures = {"relight_psnr": float(psnr), "relight_ssim": float(ssim), "frame_seconds": seconds, "turned_seconds": turned}
    about = {"train_seconds": run.seconds, "backend": variant.backend if variant.backend == "gaussian" else best_backend(run.path)}
    encoded = {name: np.round(255 * np.clip(image, 0, 1)).astype(np.uint8) for name, image in shown.items()}
    return Measurement({**figures, **about}, {"samples": sum(relighter.counts)}, encoded)


# --- report


def blocks(results: Results) -> Iterator[Block]:
    """Yield the charts, tables and images of the report."""
    scenes = [scene for scene in results.scenes if any(results.figure(scene, preset, "seconds") for preset in PRESETS)]
    timed = [scene for scene in scenes if any(" min" in r.configuration for r in results.records(scene))]
    for name, title, image in (
        ("relight_psnr", "relit", "benchmark_reconstruction"),
        ("nvs_psnr", "NVS", ""),
        ("normal_mae", "normals", ""),
    ):
        panels = {scene: list(_curves(results, scene, name)) for scene in timed}
        if panels:
            yield Chart(f"Equal time: {title}", "seconds of the whole job ↓", COLUMNS[name], panels, log_y=False, image=image)
    rows = [_row(results, scene, c) for scene in scenes for c in _configurations(results, scene) if " min" in c or c in PRESETS]
    if rows:
        yield Table("Presets, and what a time budget gives", ["scene, configuration", "seconds ↓", *COLUMNS.values()], rows)
    overtrained = [text for scene in timed if (text := _overtrained(results, scene))]
    if overtrained:
        yield Note(f"More time than did good: {'; '.join(overtrained)}.")
    yield from _part_tables(results, scenes)
    yield from _headline_blocks(results)
    yield from _phase_table(results)


def _part_tables(results: Results, scenes: list[str]) -> Iterator[Block]:
    """Yield a table for each part of the method that was measured, then what the paper reports."""
    tables = []
    for title, configurations in PARTS.items():
        measured = [scene for scene in scenes if all(results.get(scene, c) for c in configurations)]
        rows = [_row(results, scene, c) for scene in measured for c in configurations]
        if rows:
            tables.append(Table(title, ["scene, configuration", "seconds ↓", *COLUMNS.values()], rows))
    yield from tables
    if tables:
        yield Note(
            "The paper: 25.08 dB relit with 2DGRT in training, 24.25 dB without. First stage alone: relit through its own Gaussians."
        )


def _overtrained(results: Results, scene: str) -> str:
    """Return how much the longest time budget loses in relighting against the best shorter one; "" where it does not."""
    found = sorted(
        (r.figures["seconds"], r.figures["relight_psnr"]) for r in results.records(scene, f"{BUDGETED}, ") if "relight_psnr" in r.figures
    )
    if not found:
        return ""
    (seconds, best), (longest, last) = max(found, key=lambda point: point[1]), found[-1]
    if best - last < NOTICED:
        return ""
    return f"{scene}: {best - last:.1f} dB relit lost from {seconds:.0f} to {longest:.0f} s"


def _configurations(results: Results, scene: str) -> list[str]:
    """Return the configurations of a scene whose time was measured."""
    return [r.configuration for r in results.records(scene) if "seconds" in r.figures]


def _row(results: Results, scene: str, configuration: str) -> list[Any]:
    """Return a table's row of a scene and configuration."""
    record = results.get(scene, configuration)
    figures = {} if record is None else record.figures
    return [f"{scene}, {configuration}", *(figures.get(name) for name in ("seconds", *COLUMNS))]


def _curves(results: Results, scene: str, name: str) -> Iterator[Series]:
    """Yield the jobs with time budgets as a curve, and the presets without as single points."""
    found = [r.figures for r in results.records(scene, f"{BUDGETED}, ") if name in r.figures]
    found.sort(key=lambda figures: figures["seconds"])
    yield Series(f"{BUDGETED} --time", [f["seconds"] for f in found], [f[name] for f in found])
    for preset in PRESETS:
        seconds, value = (results.figure(scene, preset, n) for n in ("seconds", name))
        if seconds and value is not None:
            yield Series(preset, [seconds], [value], line=False)


def _headline_blocks(results: Results) -> Iterator[Block]:
    """Yield the table and the images of the paper's headline."""
    rows = []
    for scene in results.scenes:
        for name in HEADLINE:
            record = results.get(scene, f"headline, {name}")
            if record is None:
                continue
            f = record.figures
            rates = (1 / f["frame_seconds"], 1 / f["turned_seconds"], irgs_baseline.times_as_fast(results, scene, name))
            numbers = (f["relight_psnr"], f["relight_ssim"], *rates, f["train_seconds"])
            rows.append([f"{scene}, {name}", record.counted["samples"], *numbers])
    if rows:
        columns = ("", "samples", "relit dB ↑", "SSIM ↑", "frames/s ↑", "light turned, frames/s ↑", "times as fast ↑", "training s ↓")
        yield Table("The paper's headline: IRGS against IRGS++", columns, rows)
        yield Note(irgs_baseline.ABOUT)
        yield Note("The paper, on a GPU: from 0.5 to 25 frames a second, 50 times as fast, at better quality.")
        yield Images("A view under a new light by each", list(_headline_images(results)))


def _headline_images(results: Results) -> Iterator[list[tuple[str, str]]]:
    """Yield a row for each scene: the true image, then each configuration's with its error (efficient looks like HQ)."""
    for scene in results.scenes:
        row = []
        for name in list(HEADLINE)[:2]:
            record = results.get(scene, f"headline, {name}")
            files = record.images if record else {}
            row += [(f"{scene}: true", files["true"])] if files and not row else []
            row += [(f"{name}{what}", files[key]) for key, what in (("ours", ""), ("error to 0.2", ", error to 0.2")) if files]
        if row:
            yield row


def _phase_table(results: Results) -> Iterator[Block]:
    """Yield the table of the balanced job's seconds by phase."""
    rows = []
    for record in results.records(prefix="balanced"):
        if record.configuration == "balanced":
            phases = {n.removesuffix("_seconds"): v for n, v in record.figures.items() if n.endswith("_seconds") and n != "cpu_seconds"}
            memory = record.figures["peak_memory_bytes"] / 2**30
            rows.append((record, phases, memory))
    if rows:
        names = list(rows[0][1])
        table = [[r.scene, *(phases.get(n) for n in names), memory, r.figures["cpu_seconds"]] for r, phases, memory in rows]
        yield Table("Seconds of each phase of the balanced job ↓", ["scene", *names, "peak memory GiB ↓", "CPU seconds"], table)
