# SPDX-License-Identifier: GPL-3.0-or-later
"""The evaluation of a run: every figure that the dataset's truth allows, as a table, JSON and a page with images."""

from __future__ import annotations

import json
import os
from collections.abc import Iterator, Sequence
from dataclasses import asdict, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from ..errors import Cancelled, InputError
from ..machine.devices import best
from ..progress.protocol import Progress, Silent
from ..relight.backends import best_backend, open_relighter
from ..relight.prepared_light import PreparedLight, prepare
from ..relight.relighter import Relighter, RelightSettings
from ..rendering.gbuffer import render_gbuffer
from ..scene.mesh_ply import load_mesh_ply
from ..scene.reconstruction import Reconstruction
from ..settings.schema import DataSettings
from . import metrics
from .cases import Case, Cases, read_cases, spread
from .cycles import compare
from .ground_truth import SceneTruth, Truth
from .html_report import SHOWN, page
from .lpips import NO_LPIPS, Lpips, find_lpips
from .prediction import Prediction
from .protocols import PLAIN, Protocol, described, protocol_named
from .view_metrics import Fits, averages, fitted_figures, relit_figures, view_figures

CHAMFER_UNIT = 2000  # what Stanford-ORB's tables multiply by
CYCLES_PROTOCOL = (
    "cycles_difference, cycles_psnr: our images of the Gaussians against the exported mesh and textures in Cycles, all bounces, encoded; "
    "the difference is the mean where either shows something, albedo as estimated."
)


def evaluate(
    run: Path,
    dataset: Path,
    output: Path | None = None,
    settings: DataSettings | None = None,
    progress: Progress | None = None,
    cycles: int = 0,
    *,
    protocol: str = "plain",
    views: int | None = None,
    samples: int | None = None,
    lpips: Path | None = None,
) -> dict[str, Any]:
    """Compare a run with the test views of a dataset (its training views where it has no others).

    Writes `report.json` and `report.html` (self-contained) into `output`, `run/evaluation` where that is None, and returns what is in
    the JSON: "figures" (means over the views), "views" (the same per view), "albedo_scale" (3 numbers or None), "split", "novel" (how many
    of the views are under other lights), "protocol" (a line for each choice), "choices" (the same for programs).
    `settings` say how the dataset is read. So many views as `cycles` says are rendered by Cycles too, from the asset, under the lights
    that are known (the recovered one where none is). `protocol`: whose choices, see protocols.py; `views`: evenly spread, instead of all;
    `samples`: light samples of a pixel, instead of the protocol's; `lpips`: that distance as TorchScript. Raises InputError for a folder
    that is no finished run, or a dataset that can't be read; NoBlender where Cycles is asked for and there is none.
    """
    progress = progress or Silent()
    how = protocol_named(protocol)
    how = how if samples is None else replace(how, samples=samples)
    distances = {"": found} if lpips is not None and (found := find_lpips(lpips)) else _distances(how)
    reconstruction = Reconstruction.load(run).to(best())
    cases = read_cases(reconstruction, dataset, settings or DataSettings(), progress, how.relit_views, views)
    backend = best_backend(run)
    relighter = open_relighter(run, reconstruction, backend, RelightSettings(samples=how.samples))
    evaluation = Evaluation(cases, relighter, how, distances, progress)
    evaluation.work()
    report = evaluation.summary()
    report["figures"] |= scene_figures(run, reconstruction, cases.scene, how, cases.unit)
    known = cases.scene.lights or {"recovered": reconstruction.environment_map()}
    chosen = {cases.names[i]: cases.cameras[i] for i in spread(cases.own, cycles)}
    asset = compare(relighter, run, chosen, known, progress) if cycles else []
    report["figures"] |= averages([one.figures for one in asset], ())
    report["cycles"] = [{"view": one.view, "light": one.light, **one.figures} for one in asset]
    report |= {
        "run": str(run.resolve()),
        "dataset": str(dataset.resolve()),
        "split": cases.split,
        "choices": {name: list(value) if isinstance(value, tuple) else value for name, value in asdict(how).items()},
    }
    made = _made(evaluation, report["albedo_scale"], backend)
    report["protocol"] = [*described(how), *made, *([CYCLES_PROTOCOL] if cycles else [])]
    _write(output or run / "evaluation", report, page(report, evaluation.shown, how, asset))
    return report


def _distances(how: Protocol) -> dict[str, Lpips]:
    """By the suffix of the figures' names: the first network has none."""
    found = {"" if name == how.lpips[0] else f"_{name}": find_lpips(None, name) for name in how.lpips}
    return {suffix: one for suffix, one in found.items() if one is not None}


class Evaluation:
    """The views of a run compared with their truth, one by one, twice: what is fitted to all views is known after the first time.

    Args:
        lpips: by the suffix of the figures' names.
    """

    def __init__(self, cases: Cases, relighter: Relighter, how: Protocol, lpips: dict[str, Lpips], progress: Progress) -> None:
        self.cases, self.relighter, self.how, self.lpips, self.progress = cases, relighter, how, lpips, progress
        self.fits, self.rows = Fits(how), [dict[str, float]() for _ in cases.views]
        self.shown: dict[str, tuple[Prediction, Truth]] = {}  # some views with all their images
        self.lit_by: dict[str, None] = {}  # names of lights, in order
        self._prepared: dict[str, PreparedLight] = {}

    def work(self) -> None:
        """Compare all views. Raises Cancelled between two."""
        shown = spread(len(self.cases.views), SHOWN)
        first = {case.number: self._as_it_is(case, case.number in shown) for case in self._told("evaluate")}
        relighter = self.relighter.scaled(self.fits.albedo if self.how.relit_scaled else None)
        for case in self._told("relight"):
            kept = first.pop(case.number) or Prediction(render_gbuffer(relighter.reconstruction, case.camera), None)
            prediction = replace(kept, relit=self._relit(relighter, case))
            row = self.rows[case.number]
            row |= relit_figures(prediction, case.truth, self.how, self.lpips)
            row |= fitted_figures(prediction, case.truth, self.fits, self.how, self.cases.unit, self.lpips)
            self.lit_by |= dict.fromkeys(prediction.relit)
            if case.number in shown:
                self.shown[self.cases.names[case.number]] = prediction, case.truth

    def summary(self) -> dict[str, Any]:
        """All figures of the views, and their means."""
        relights, scale = [name for name in self.lit_by if name != self.cases.scene.train_light], self.fits.albedo
        return {
            "figures": averages(self.rows, relights, self.how),
            "views": dict(zip(self.cases.names, self.rows, strict=True)),
            "novel": len(self.cases.views) - self.cases.own,
            "albedo_scale": None if scale is None else [float(s) for s in scale],
        }

    def _told(self, phase: str) -> Iterator[Case]:
        """Every view; what is done is told."""
        count = len(self.cases.views)
        self.progress.phase(phase, count)
        for case in self.cases:
            yield case
            self.progress.step(case.number + 1)
            if self.progress.cancelled:
                raise Cancelled(f"stopped after {case.number + 1} of {count} views")

    def _as_it_is(self, case: Case, keep: bool) -> Prediction | None:
        """Figures of layers and of the image under the recovered light."""
        own = case.view.light is None
        shaded = self.relighter.relit(self.relighter.surface(case.camera), self._own_light).numpy() if own else None
        prediction = Prediction(render_gbuffer(self.relighter.reconstruction, case.camera), shaded)
        self.fits.gather(prediction, case.truth)
        self.rows[case.number] |= view_figures(prediction, case.truth, self.how, self.lpips)
        return prediction if keep else None

    @cached_property
    def _own_light(self) -> PreparedLight:
        return prepare(self.relighter.reconstruction.environment_map())

    def _relit(self, relighter: Relighter, case: Case) -> dict[str, np.ndarray]:
        """Pictures under every light that is known, of as many views as the protocol says."""
        known = case.truth.lights.keys() | self.cases.scene.lights.keys()
        names = [name for name in case.truth.relit if name in known]
        beyond = case.view.light is None and self.how.relit_views is not None and case.number >= self.how.relit_views
        if not names or beyond:
            return {}
        surface = relighter.surface(case.camera)
        return {name: relighter.relit(surface, self._light(case.truth, name)).numpy() for name in names}

    def _light(self, truth: Truth, name: str) -> PreparedLight:
        """Of the view alone, or of the scene; those are prepared once for all views."""
        if name in truth.lights:
            return prepare(truth.lights[name])
        if name not in self._prepared:
            self._prepared[name] = prepare(self.cases.scene.lights[name])
        return self._prepared[name]


def _made(evaluation: Evaluation, scale: Sequence[float] | None, backend: str) -> list[str]:
    """How the images of this very report were made."""
    cases, how, lpips = evaluation.cases, evaluation.how, evaluation.lpips
    unscaled = "its view's own" if how.scale_each_view else "as estimated (no true albedo is known)"
    factors = unscaled if scale is None else "times " + " ".join(f"{s:.4f}" for s in scale)
    lines = [
        f"Shaded and relit images: {how.samples} samples per pixel, {backend} backend, denoised.",
        f"Scale of the albedo: albedo {factors}.",
        f"LPIPS: {', '.join(one.name for one in lpips.values())}." if lpips else NO_LPIPS,
    ]
    if novel := len(cases.views) - cases.own:
        lines.append(f"{novel} of {cases.novel} views are photographs under other lights, which only relit images are compared with.")
    if cases.own < cases.of:
        lines.append(f"Only {cases.own} of the {cases.of} {cases.split} views, evenly spread: published tables are of all.")
    return lines


def scene_figures(
    run: Path, reconstruction: Reconstruction, scene: SceneTruth, how: Protocol = PLAIN, unit: float = 1.0
) -> dict[str, float]:
    """Figures of the light and of the mesh, where the truth is known; `unit` as in `fitted_figures`."""
    figures = {}
    if scene.train_light in scene.lights:
        figures |= metrics.environment_figures(reconstruction.environment_map(), scene.lights[scene.train_light], how.light_grid)
    if scene.points is not None and (run / "mesh.ply").is_file():
        mesh = load_mesh_ply(run / "mesh.ply")
        figures |= metrics.mesh_distances(mesh, *scene.points)
        if how.scale_free:
            figures["shape_chamfer"] = CHAMFER_UNIT * metrics.squared_chamfer(mesh, scene.points[0]) / unit**2
    return figures


def table(report: dict[str, Any]) -> str:
    """The mean figures as aligned lines of text."""
    lines = [f"{name:28s} {metrics.shown(value):>10s}" for name, value in report["figures"].items()]
    if report["albedo_scale"]:
        lines.append(f"{'albedo_scale':28s} " + " ".join(f"{s:10.4f}" for s in report["albedo_scale"]))
    lines.append(f"{report['split'] + ' views':28s} {len(report['views']) - report['novel']:10d}")
    lines += [f"{'views under other lights':28s} {report['novel']:10d}"] if report["novel"] else []
    return "\n".join([*lines, *report["protocol"]])


def _write(folder: Path, report: dict[str, Any], html: str) -> None:
    try:
        folder.mkdir(parents=True, exist_ok=True)
        for name, text in (("report.json", json.dumps(report, indent=1)), ("report.html", html)):
            partial = folder / f".{name}.part"
            partial.write_text(text, encoding="utf-8")
            os.replace(partial, folder / name)
    except OSError as error:
        raise InputError(folder, f"the report can't be written there ({error.strerror})") from error
