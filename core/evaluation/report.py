# SPDX-License-Identifier: GPL-3.0-or-later
"""The evaluation of a run: every figure that the dataset's truth allows, as a table, JSON and a page with pictures."""

from __future__ import annotations

import json
import os
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from ..config import DataSettings
from ..datasets.camera import Camera
from ..datasets.dataset import View
from ..datasets.load import load_dataset
from ..errors import Cancelled, InputError
from ..progress import Progress, Silent
from ..relight.backends import best_backend, open_relighter
from ..relight.lighting import prepare
from ..relight.relighter import Relighter, RelightSettings
from ..scene.ply import load_mesh_ply
from ..scene.reconstruction import Reconstruction
from ..stages.render import render_view
from . import metrics
from .cycles import compare
from .figures import Prediction, albedo_figures, averages, view_figures
from .page import page
from .truth import SceneTruth, Truth, load_scene_truth, load_truth

SAMPLES = 64  # of shaded and relit pictures
CYCLES_PROTOCOL = (
    "cycles_difference, cycles_psnr: our pictures of the Gaussians against the exported mesh and textures in Cycles, all bounces, encoded; "
    "the difference is the mean where either shows something, albedo as estimated."
)


def evaluate(
    run: Path,
    dataset: Path,
    output: Path | None = None,
    settings: DataSettings | None = None,
    progress: Progress | None = None,
    cycles: int = 0,
) -> dict[str, Any]:
    """Compare a run with the test views of a dataset (its training views where it has no others).

    Writes `report.json` and `report.html` (self-contained) into `output`, `run/evaluation` where that is None, and returns what is in
    the JSON: "figures" (means over the views), "views" (the same per view), "albedo_scale" (3 numbers or None), "split", "protocol".
    `settings` say how the dataset is read. So many views as `cycles` says are rendered by Cycles too, from the asset, under the lights
    that are known (the recovered one where none is). Raises InputError for a folder that is no finished run, or a dataset that can't be
    read; NoBlender where Cycles is asked for and there is none.
    """
    progress = progress or Silent()
    reconstruction = Reconstruction.load(run)
    data = load_dataset(dataset, settings or DataSettings(), progress)
    split, views = ("test", data.test) if data.test else ("train", data.train)
    scene = load_scene_truth(dataset, reconstruction.to_world)
    same = reconstruction.to_world @ np.linalg.inv(data.to_world)  # read on its own, a dataset may be placed otherwise
    cameras = [view.camera.moved(same) for view in views]
    truths = [load_truth(view, scene, reconstruction.to_world) for view in views]
    backend = best_backend(run)
    relighter = open_relighter(run, reconstruction, backend, RelightSettings(samples=SAMPLES))
    predictions = shaded_views(relighter, cameras, progress)
    _, scale = albedo_figures(predictions, truths)
    lights = [{name: scene.lights[name] for name in truth.relit} for truth in truths]
    predictions = relit_views(relighter.scaled(scale), predictions, cameras, lights, progress)
    report = summarise(views, predictions, truths, scene)
    report["figures"] |= scene_figures(run, reconstruction, scene)
    chosen = np.unique(np.linspace(0, len(views) - 1, min(cycles, len(views))).round().astype(int)) if cycles else []
    known = scene.lights or {"recovered": reconstruction.environment_map()}
    asset = compare(relighter, run, {views[i].name: cameras[i] for i in chosen}, known, progress) if cycles else []
    report["figures"] |= averages([one.figures for one in asset], ())
    report["cycles"] = [{"view": one.view, "light": one.light, **one.figures} for one in asset]
    report |= {"run": str(run.resolve()), "dataset": str(dataset.resolve()), "split": split}
    report["protocol"] = [*protocol(report["albedo_scale"], backend), *([CYCLES_PROTOCOL] if cycles else [])]
    _write(output or run / "evaluation", report, page(report, views, predictions, truths, asset))
    return report


def shaded_views(relighter: Relighter, cameras: Sequence[Camera], progress: Progress) -> list[Prediction]:
    """The layers of each view, and its picture under the recovered light with the albedo as it is."""
    reconstruction, predictions = relighter.reconstruction, []
    light = prepare(reconstruction.environment_map())
    progress.phase("evaluate", len(cameras))
    for camera in cameras:
        shaded = relighter.relit(relighter.surface(camera), light).numpy()
        predictions.append(Prediction(render_view(reconstruction, camera), shaded))
        _stepped(progress, len(predictions), len(cameras))
    return predictions


def relit_views(
    relighter: Relighter,
    predictions: Sequence[Prediction],
    cameras: Sequence[Camera],
    lights: Sequence[dict[str, np.ndarray]],
    progress: Progress,
) -> list[Prediction]:
    """The predictions, and with them each view's pictures under its named lights."""
    prepared, complete = {}, []
    progress.phase("relight", len(cameras))
    for prediction, camera, names in zip(predictions, cameras, lights, strict=True):
        prepared |= {name: prepare(light) for name, light in names.items() if name not in prepared}
        surface = relighter.surface(camera) if names else None
        relit = {name: relighter.relit(surface, prepared[name]).numpy() for name in names} if surface else {}
        complete.append(replace(prediction, relit=relit))
        _stepped(progress, len(complete), len(cameras))
    return complete


def _stepped(progress: Progress, done: int, of: int) -> None:
    progress.step(done)
    if progress.cancelled:
        raise Cancelled(f"stopped after {done} of {of} views")


def protocol(scale: Sequence[float] | None, backend: str) -> list[str]:
    """How the figures were made, a line each: published ones differ in this and can't be compared otherwise."""
    factors = "as estimated (no true albedo is known)" if scale is None else "times " + " ".join(f"{s:.4f}" for s in scale)
    fitted = "" if scale is None else ", the median of true / estimated albedo per channel over all views"
    return [
        "Pictures: sRGB-encoded, clipped to 0..1, on black by their own alpha; means over the views, then over the lights.",
        f"Shaded and relit pictures: {SAMPLES} samples per pixel, {backend} backend, denoised.",
        f"Relit pictures: albedo {factors}{fitted}. Pictures under the recovered light: albedo as estimated.",
        "Albedo: linear, times the true alpha, after that scale.",
        "Environment: on the true map's grid, one least-squares scale per channel weighted by solid angle, sRGB-encoded, clipped to 0..1; "
        "environment_psnr_unscaled without the scale.",
    ]


def summarise(views: Sequence[View], predictions: Sequence[Prediction], truths: Sequence[Truth], scene: SceneTruth) -> dict[str, Any]:
    """All figures of the views, and their means."""
    albedo_rows, scale = albedo_figures(predictions, truths)
    rows = [view_figures(p, t) | a for p, t, a in zip(predictions, truths, albedo_rows, strict=True)]
    relights = [name for name in scene.lights if name != scene.train_light]
    return {
        "figures": averages(rows, relights),
        "views": {view.name: row for view, row in zip(views, rows, strict=True)},
        "albedo_scale": None if scale is None else [float(s) for s in scale],
    }


def scene_figures(run: Path, reconstruction: Reconstruction, scene: SceneTruth) -> dict[str, float]:
    """Figures of the light and of the mesh, where the truth is known."""
    figures = {}
    if scene.train_light in scene.lights:
        figures |= metrics.environment_figures(reconstruction.environment_map(), scene.lights[scene.train_light])
    if scene.points is not None and (run / "mesh.ply").is_file():
        figures |= metrics.mesh_distances(load_mesh_ply(run / "mesh.ply"), *scene.points)
    return figures


def table(report: dict[str, Any]) -> str:
    """The mean figures as aligned lines of text."""
    lines = [f"{name:28s} {metrics.shown(value):>10s}" for name, value in report["figures"].items()]
    if report["albedo_scale"]:
        lines.append(f"{'albedo_scale':28s} " + " ".join(f"{s:10.4f}" for s in report["albedo_scale"]))
    lines.append(f"{report['split'] + ' views':28s} {len(report['views']):10d}")
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
