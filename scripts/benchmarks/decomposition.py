# SPDX-License-Identifier: GPL-3.0-or-later
"""Section on decomposition: albedo, roughness, metallic, light, new views and relit views, each against the ground truth."""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial
from pathlib import Path

import numpy as np
from irgspp.core.evaluation import metrics, visualisation
from irgspp.core.evaluation.ground_truth import Truth
from irgspp.core.evaluation.lpips import NO_LPIPS, Lpips, find_lpips
from irgspp.core.evaluation.prediction import Prediction
from irgspp.core.relight.backends import best_backend, open_relighter
from irgspp.core.relight.prepared_light import prepare_light
from irgspp.core.relight.relight_settings import RelightSettings
from irgspp.core.relight.relighter import Relighter
from irgspp.core.rendering.gbuffer import render_gbuffer
from irgspp.core.scene.reconstruction import Reconstruction

from .bench import PRESETS, Bench, Scene
from .section import Block, Images, Measurement, Note, Table, Task
from .store import Results

NAME = "decomposition"
TITLE = "Decomposition"
ABOUT = (
    "The balanced run against the ground truth, means over all test views. Albedo: linear, after one scale per channel, because its "
    "brightness can't be separated from the light's. Light: after such a scale too. NVS: new views under the photographs' light."
)
ONCE = False
TABLES = {
    "Images": {
        "nvs_psnr": "NVS dB ↑",
        "nvs_ssim": "SSIM ↑",
        "nvs_lpips": "LPIPS ↓",
        "relight_psnr": "relit dB ↑",
        "relight_ssim": "SSIM ↑",
        "relight_lpips": "LPIPS ↓",
        "radiance_psnr": "Gaussians' own radiance dB ↑",
    },
    "Materials and light": {
        "albedo_psnr": "albedo dB ↑",
        "albedo_ssim": "SSIM ↑",
        "albedo_lpips": "LPIPS ↓",
        "roughness_mae": "roughness, mean error ↓",
        "metallic_mae": "metallic, mean error ↓",
        "environment_psnr": "light dB ↑",
        "environment_ssim": "SSIM ↑",
    },
}
SAMPLES = 64


def tasks(bench: Bench, scene: Scene | None) -> Iterator[Task]:
    """Yield the measurements of a scene: metrics of each preset, and images of one view.

    Args:
        bench: options, scenes and reconstructions.
        scene: scene to measure.
    """
    assert scene is not None
    for preset in bench.presets:
        plan = bench.plan(preset, preset=preset)
        yield Task(preset, partial(_figures, bench, scene, preset), bench.evaluation_seconds, [plan])
    yield Task("pictures", partial(_shown, bench, scene), bench.evaluation_seconds / 3, [bench.balanced()])


def _figures(bench: Bench, scene: Scene, preset: str) -> Measurement:
    """Measure the evaluation's metrics of a preset's run, and LPIPS where it is available."""
    run = bench.run(scene, bench.plan(preset, preset=preset))
    report = bench.evaluation(scene, run.path)
    names = [name for table in TABLES.values() for name in table]
    figures = {name: report["figures"][name] for name in names if name in report["figures"]}
    lpips = find_lpips(bench.lpips)
    if lpips is not None:
        figures |= _lpips(scene, run.path, report["albedo_scale"], lpips)
    return Measurement({**figures, "lpips_by": lpips.name if lpips else ""}, {"views": len(scene.views)})


def _lpips(scene: Scene, run: Path, scale: list[float] | None, lpips: Lpips) -> dict[str, float]:
    """Return LPIPS of new views, relit views and albedo: means over views, and over lights where there are several."""
    plain, lights = _relighter(run), {name: prepare_light(scene.truth.lights[name]) for name in scene.relights}
    relighter, own = plain.with_albedo_scale(scale), prepare_light(plain.reconstruction.environment_map())
    values: dict[str, list[float]] = {"nvs_lpips": [], "relight_lpips": [], "albedo_lpips": []}
    for view in scene.views:
        truth = scene.view_truth(view)
        shaded = plain.relit(plain.surface(view.camera), own).numpy()
        values["nvs_lpips"].append(lpips(metrics.on_black(shaded), truth.image))
        surface = relighter.surface(view.camera)
        for name in lights.keys() & truth.relit.keys():
            values["relight_lpips"].append(lpips(metrics.on_black(relighter.relit(surface, lights[name]).numpy()), truth.relit[name]))
        if truth.albedo is not None:
            albedo = Prediction(render_gbuffer(plain.reconstruction, view.camera), shaded).layer("albedo") * np.array(scale or (1, 1, 1))
            alpha = truth.alpha[..., None]
            values["albedo_lpips"].append(lpips(np.clip(albedo * alpha, 0, 1), np.clip(truth.albedo * alpha, 0, 1)))
    return {name: float(np.mean(found)) for name, found in values.items() if found}


def _relighter(run: Path) -> Relighter:
    """Open a run for relighting."""
    return open_relighter(run, Reconstruction.load(run), best_backend(run), RelightSettings(samples=SAMPLES))


def _shown(bench: Bench, scene: Scene) -> Measurement:
    """Render every layer of one view next to the true one."""
    run = bench.run(scene, bench.balanced())
    scale = bench.evaluation(scene, run.path)["albedo_scale"]
    plain, view = _relighter(run.path), scene.views[0]
    relighter, truth = plain.with_albedo_scale(scale), scene.view_truth(view)
    shaded = plain.relit(plain.surface(view.camera), prepare_light(plain.reconstruction.environment_map())).numpy()
    prediction = Prediction(render_gbuffer(plain.reconstruction, view.camera), shaded)
    shown = {"photograph": truth.image, "photograph, ours": metrics.on_black(shaded)}
    shown["photograph, error to 0.2"] = _error(truth.image, shown["photograph, ours"])
    for name in scene.relights[:2]:
        ours = metrics.on_black(relighter.relit(relighter.surface(view.camera), prepare_light(scene.truth.lights[name])).numpy())
        shown |= {name: truth.relit[name], f"{name}, ours": ours, f"{name}, error to 0.2": _error(truth.relit[name], ours)}
    layers = _layers(prediction, truth, np.array(scale or (1.0, 1.0, 1.0)))
    return Measurement({}, {}, {n: np.round(255 * np.clip(p, 0, 1)).astype(np.uint8) for n, p in (shown | layers).items()})


def _layers(prediction: Prediction, truth: Truth, scale: np.ndarray) -> dict[str, np.ndarray]:
    """Return the true layer, ours and their difference for each layer with ground truth, as (H, W, 3) encoded images."""
    found, alpha = {}, truth.alpha
    for name in ("albedo", "roughness", "metallic"):
        true, ours = getattr(truth, name), prediction.layer(name)
        if true is None:
            continue
        if name == "albedo":
            pair = [visualisation.colour(true, alpha), visualisation.colour(ours * scale, alpha)]
        else:
            pair = [visualisation.grey(true, alpha), visualisation.grey(ours, alpha)]
        true, ours = (image[..., :3] * image[..., 3:] for image in pair)
        found |= {name: true, f"{name}, ours": ours, f"{name}, error to 0.2": _error(true, ours)}
    return found


def _error(true: np.ndarray, ours: np.ndarray) -> np.ndarray:
    """Return the largest difference of the channels as a heat map, (H, W, 3)."""
    return visualisation.heat(np.abs(true - ours).max(-1), 0.2)[..., :3]


# --- report


def blocks(results: Results) -> Iterator[Block]:
    """Yield the tables of metrics and the images of the report."""
    for title, columns in TABLES.items():
        found = [r for r in results.records() if r.configuration in PRESETS]
        known = [name for name in columns if any(name in r.figures for r in found)]
        rows = [[f"{r.scene}, {r.configuration}", *(r.figures.get(name) for name in known)] for r in found]
        if rows:
            yield Table(title, ["", *(columns[name] for name in known)], rows)
    if not any(r.figures.get("lpips_by") for r in results.records()):
        yield Note(NO_LPIPS)
    yield Note("The paper uses the same protocol for relit images on other scenes, so its metrics can't be compared with these.")
    for record in results.records(prefix="pictures"):
        files = list(record.images.items())
        yield Images(record.scene, [files[i : i + 6] for i in range(0, len(files), 6)])
