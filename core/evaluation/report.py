# SPDX-License-Identifier: GPL-3.0-or-later
"""The evaluation of a run: every figure that the dataset's truth allows, as a table, JSON and a page with pictures."""

from __future__ import annotations

import json
import os
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from ..config import DataSettings
from ..datasets.camera import Camera
from ..datasets.dataset import View
from ..datasets.load import load_dataset
from ..errors import Cancelled, InputError
from ..progress import Progress, Silent
from ..scene.ply import load_mesh_ply
from ..scene.reconstruction import Reconstruction
from ..stages.render import render_view, shade_view
from . import metrics
from .figures import Prediction, albedo_figures, averages, view_figures
from .page import page
from .truth import SceneTruth, Truth, load_scene_truth, load_truth


def evaluate(
    run: Path, dataset: Path, output: Path | None = None, settings: DataSettings | None = None, progress: Progress | None = None
) -> dict[str, Any]:
    """Compare a run with the test views of a dataset (its training views where it has no others).

    Writes `report.json` and `report.html` (self-contained) into `output`, `run/evaluation` where that is None, and returns what is in
    the JSON: "figures" (means over the views), "views" (the same per view), "albedo_scale" (3 numbers or None), "split".
    `settings` say how the dataset is read. Raises InputError for a folder that is no finished run, or a dataset that can't be read.
    """
    progress = progress or Silent()
    reconstruction = Reconstruction.load(run)
    data = load_dataset(dataset, settings or DataSettings(), progress)
    split, views = ("test", data.test) if data.test else ("train", data.train)
    scene = load_scene_truth(dataset, reconstruction.to_world)
    same = reconstruction.to_world @ np.linalg.inv(data.to_world)  # read on its own, a dataset may be placed otherwise
    truths, predictions = [], []
    progress.phase("evaluate", len(views))
    for i, view in enumerate(views):
        truths.append(load_truth(view, scene, reconstruction.to_world))
        predictions.append(predict(reconstruction, view.camera.moved(same), {name: scene.lights[name] for name in truths[-1].relit}))
        progress.step(i + 1)
        if progress.cancelled:
            raise Cancelled(f"stopped after {i + 1} of {len(views)} views")
    report = summarise(views, predictions, truths, scene)
    report["figures"] |= scene_figures(run, reconstruction, scene)
    report |= {"run": str(run.resolve()), "dataset": str(dataset.resolve()), "split": split}
    _write(output or run / "evaluation", report, page(report, views, predictions, truths))
    return report


def predict(reconstruction: Reconstruction, camera: Camera, lights: dict[str, np.ndarray]) -> Prediction:
    """Everything that is compared of one view."""
    relit = {name: shade_view(reconstruction, camera, light) for name, light in lights.items()}
    return Prediction(render_view(reconstruction, camera), shade_view(reconstruction, camera, None), relit)


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
        figures["environment_psnr"] = metrics.environment_psnr(reconstruction.environment_map(), scene.lights[scene.train_light])
    if scene.points is not None and (run / "mesh.ply").is_file():
        figures |= metrics.mesh_distances(load_mesh_ply(run / "mesh.ply"), *scene.points)
    return figures


def table(report: dict[str, Any]) -> str:
    """The mean figures as aligned lines of text."""
    lines = [f"{name:28s} {metrics.shown(value):>10s}" for name, value in report["figures"].items()]
    if report["albedo_scale"]:
        lines.append(f"{'albedo_scale':28s} " + " ".join(f"{s:10.4f}" for s in report["albedo_scale"]))
    return "\n".join([*lines, f"{report['split'] + ' views':28s} {len(report['views']):10d}"])


def _write(folder: Path, report: dict[str, Any], html: str) -> None:
    try:
        folder.mkdir(parents=True, exist_ok=True)
        for name, text in (("report.json", json.dumps(report, indent=1)), ("report.html", html)):
            partial = folder / f".{name}.part"
            partial.write_text(text, encoding="utf-8")
            os.replace(partial, folder / name)
    except OSError as error:
        raise InputError(folder, f"the report can't be written there ({error.strerror})") from error
