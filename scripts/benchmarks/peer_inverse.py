# SPDX-License-Identifier: GPL-3.0-or-later
"""Mitsuba's inverse rendering of a scene with given shape, next to our second stage at equal time."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cache, partial
from pathlib import Path
from typing import Any

import numpy as np
from irgspp.core.evaluation import metrics, visualisation
from irgspp.core.evaluation.prediction import Prediction
from irgspp.core.evaluation.view_metrics import albedo_metrics, averages, view_metrics
from irgspp.core.io.srgb import decode_srgb, encode_srgb
from irgspp.core.rendering.gbuffer import render_gbuffer
from irgspp.core.scene.camera import Camera
from irgspp.core.scene.dataset import View
from irgspp.core.scene.gbuffer import GBuffer
from irgspp.core.scene.reconstruction import Reconstruction

from . import mitsuba_peer
from .bench import Bench, Scene
from .section import Block, Images, Measurement, Note, Table, Task
from .store import Results

PREFIX = "inverse: "
OURS, MITSUBA = "our second stage", "Mitsuba"
TIMES = (1, 2)  # multiples of our second stage's time
FIGURES = ("albedo_psnr", "roughness_mae", "metallic_mae", "environment_psnr", "nvs_psnr", "relight_psnr")
UNITS = ("albedo dB ↑", "roughness error ↓", "metallic error ↓", "light dB ↑", "NVS dB ↑", "relit dB ↑")
SHADED = 4  # test views that are rendered with light
LAYER_SAMPLES, SHADED_SAMPLES = 16, 64
PIXELS, SAMPLES, BOUNCES = 1024, 16, 1  # of an iteration; as many bounces of indirect light as our second stage
ROWS = 32  # of the light map
RATES = {"vertex_albedo": 0.03, "vertex_roughness": 0.01, "vertex_metallic": 0.01, "light": 0.1}
ROUGHNESS = 0.5  # initial value
SEEDS = (0, 1, 2)
NAMES = ("origin", "corner", "right", "down")  # vectors of a view's rays
OPAQUE, SATURATED = 0.99, 254.5 / 255  # alpha above the first: the object alone; colour from the second on: saturated


@dataclass(frozen=True, eq=False)
class State:
    """Materials and light after some time of optimisation.

    Attributes:
        seconds: seconds spent, without compiling.
        iterations: iterations done.
        materials: vertex_albedo (V, 3), vertex_roughness and vertex_metallic (V,).
        light: (H, W, 3) linear lat-long map.
    """

    seconds: float
    iterations: int
    materials: dict[str, np.ndarray]
    light: np.ndarray


def optimise(run: Path, views: Sequence[View], metal: bool, budgets: Sequence[float], **changes) -> list[State]:
    """Optimise materials and light of a run's mesh by Mitsuba.

    Args:
        run: run folder with the mesh.
        views: training views.
        metal: initial metallic value: whether the first stage takes the object for metal.
        budgets: seconds, in rising order.
        **changes: values of the request that replace the defaults.

    Returns:
        The states after each of the budgets.
    """
    asset = mitsuba_peer.welded(run)
    count = len(asset["vertices"])
    pixels = pool(views)
    mean = float(decode_srgb(pixels["pixel_colour"]).mean())
    start = {
        "vertex_albedo": np.full((count, 3), 0.5, np.float32),
        "vertex_roughness": np.full(count, ROUGHNESS, np.float32),
        "vertex_metallic": np.full(count, float(metal), np.float32),
        "light": np.full((ROWS, 2 * ROWS, 3), 2 * mean, np.float32),
    }
    request = {"pixels": PIXELS, "samples": SAMPLES, "bounces": BOUNCES, "rates": RATES, "light_smoothness": 5e-4}
    answer, found = _run_with_seeds(request | {"budgets": list(budgets), **changes}, {**asset, **pixels, **start})
    return [_state(i, about, found) for i, about in enumerate(answer["states"])]


def _run_with_seeds(request: dict[str, Any], arrays: dict[str, np.ndarray]) -> tuple[dict[str, Any], dict[str, np.ndarray]]:
    """Return the answer with the first of SEEDS that does not crash; raise Crashed where all do.

    Mitsuba crashes now and then after some hundred updates of a scene (its issues 642 and 662); with other random pixels it continues.
    """
    for seed in SEEDS[:-1]:
        with contextlib.suppress(mitsuba_peer.Crashed):
            return mitsuba_peer.run_child("mitsuba_inverse", {**request, "seed": seed}, arrays)
    return mitsuba_peer.run_child("mitsuba_inverse", {**request, "seed": SEEDS[-1]}, arrays)


def _state(number: int, about: dict[str, float], found: dict[str, np.ndarray]) -> State:
    """Return a saved state."""
    materials = {name: found[f"{name}_{number}"] for name in ("vertex_albedo", "vertex_roughness", "vertex_metallic")}
    return State(about["seconds"], int(about["iterations"]), materials, centred(found[f"light_{number}"]))


def centred(light: np.ndarray) -> np.ndarray:
    """Resample a light map whose first and last rows are at the poles to our layout, whose rows are half a texel away from them.

    Args:
        light: (H, W, 3).

    Returns:
        (H, W, 3).
    """
    height = len(light)
    at = (np.arange(height) + 0.5) / height * (height - 1)
    low = np.minimum(at.astype(int), height - 2)
    fraction = (at - low)[:, None, None].astype(np.float32)
    return (1 - fraction) * light[low] + fraction * light[low + 1]


def pool(views: Sequence[View]) -> dict[str, np.ndarray]:
    """Return all pixels that show the object alone, and the rays of their cameras; see `mitsuba_pixels.PixelSensor`.

    Args:
        views: training views.

    Returns:
        pixel_view (K,), pixel_place (K, 2), pixel_colour (K, 3) sRGB-encoded, pixel_saturated (K, 3) bool, and view_<vector> (N, 3).
    """
    number, place, colour, lens = [], [], [], []
    for i, view in enumerate(views):
        inside = np.ones(view.colour.shape[:2], bool) if view.alpha is None else view.alpha > OPAQUE
        row, column = np.nonzero(inside)
        number.append(np.full(len(row), i, np.uint32))
        place.append(np.stack([column, row], 1).astype(np.float32))
        colour.append(view.colour[inside].astype(np.float32))
        camera = view.camera
        axes = camera.to_world[:3, :3] * np.array([1.0, -1.0, -1.0])  # right, down, forward
        right, down = axes[:, 0] / camera.fx, axes[:, 1] / camera.fy
        lens.append((camera.centre, axes[:, 2] - camera.cx * right - camera.cy * down, right, down))
    colours = np.concatenate(colour)
    rays = {f"view_{name}": np.stack(values).astype(np.float32) for name, values in zip(NAMES, zip(*lens, strict=True), strict=True)}
    pixels = {"pixel_view": np.concatenate(number), "pixel_place": np.concatenate(place), "pixel_colour": colours}
    return {**pixels, "pixel_saturated": colours >= SATURATED, **rays}


def tasks(bench: Bench, scene: Scene) -> Iterator[Task]:
    """Yield the measurements of our second stage, and of Mitsuba's state at each multiple of its time.

    Args:
        bench: options, scenes and reconstructions.
        scene: scene to measure.
    """
    times, run = TIMES[:1] if bench.quick else TIMES, [bench.balanced()]

    @cache
    def states() -> list[State]:
        """Optimise once, when the first task needs it."""
        made = bench.run(scene, bench.balanced())
        seconds = made.phase_seconds()["second stage"]
        return optimise(made.path, scene.data.train, Reconstruction.load(made.path).has_split_sum, [n * seconds for n in times])

    yield Task(f"{PREFIX}{OURS}", partial(_ours, bench, scene), 20.0, run)
    for number, times_ours in enumerate(times):
        work = partial(_theirs, bench, scene, states, number)
        yield Task(f"{PREFIX}{MITSUBA}, {times_ours} x", work, (20.0 if bench.quick else 60.0) * times_ours, run)


def _shaded_views(scene: Scene) -> list[View]:
    """Return a few test views far apart."""
    return [scene.views[i] for i in np.unique(np.linspace(0, len(scene.views), SHADED, endpoint=False).astype(int))]


def _ours(bench: Bench, scene: Scene) -> Measurement:
    """Return the metrics of the run's evaluation, and images of the views that Mitsuba renders."""
    run = bench.run(scene, bench.balanced())
    report, shaded = bench.evaluation(scene, run.path), _shaded_views(scene)
    few = averages([report["views"][view.name] for view in shaded], scene.relights)
    figures = {**report["figures"], **{name: few[name] for name in few if name.startswith(("nvs", "relight"))}}
    reconstruction = Reconstruction.load(run.path)
    albedo = render_gbuffer(reconstruction, shaded[0].camera).albedo
    true = scene.view_truth(shaded[0])
    assert true.albedo is not None
    shown = {"true albedo": _albedo(true.albedo, 1.0, true.alpha), "our albedo": _albedo(albedo, report["albedo_scale"], true.alpha)}
    shown |= {"our light": _map(reconstruction.environment_map()), "true light": _map(scene.truth.lights[str(scene.truth.train_light)])}
    seconds = run.phase_seconds()["second stage"]
    return Measurement({"seconds": seconds, **{name: figures[name] for name in FIGURES if name in figures}}, {}, shown)


def _theirs(bench: Bench, scene: Scene, states, number: int) -> Measurement:
    """Measure a state of Mitsuba's optimisation as Mitsuba renders it, by our own metrics."""
    state: State = states()[number]
    asset = mitsuba_peer.welded(bench.run(scene, bench.balanced()).path)
    cameras, shaded = {view.name: view.camera for view in scene.views}, _shaded_views(scene)
    truths = [scene.view_truth(view) for view in scene.views]
    seen = mitsuba_peer.images(asset | state.materials, cameras, {"found": state.light}, [], layers=LAYER_SAMPLES)
    predictions = [_prediction(cameras[name], seen[name, "found"].layers) for name in cameras]
    rows, scale = albedo_metrics(predictions, truths)
    assert scale is not None
    scaled = {**state.materials, "vertex_albedo": state.materials["vertex_albedo"] * scale.astype(np.float32)}
    few = {view.name: view.camera for view in shaded}
    nvs = mitsuba_peer.images(asset | state.materials, few, {"found": state.light}, [SHADED_SAMPLES])
    relit = mitsuba_peer.images(asset | scaled, few, {name: scene.truth.lights[name] for name in scene.relights}, [SHADED_SAMPLES])
    for view, prediction, truth, row in zip(scene.views, predictions, truths, rows, strict=True):
        if view.name in few:
            images_of = {light: relit[view.name, light].frames[0].rgba for light in scene.relights}
            row |= view_metrics(replace(prediction, shaded=nvs[view.name, "found"].frames[0].rgba, relit=images_of), truth)
        else:
            materials = view_metrics(prediction, truth)
            row |= {name: materials[name] for name in ("roughness_mae", "metallic_mae") if name in materials}
    figures = averages(rows, scene.relights)
    figures |= metrics.environment_metrics(state.light, scene.truth.lights[str(scene.truth.train_light)])
    first = next(i for i, view in enumerate(scene.views) if view.name == shaded[0].name)
    shown = {"albedo": _albedo(predictions[first].buffers.albedo, scale, truths[first].alpha), "light": _map(state.light)}
    return Measurement(
        {"seconds": state.seconds, **{n: figures[n] for n in FIGURES if n in figures}}, {"iterations": state.iterations}, shown
    )


def _prediction(camera: Camera, layers: dict[str, np.ndarray]) -> Prediction:
    """Return a prediction of the materials alone."""
    alpha = layers["alpha"]
    none = np.zeros((*alpha.shape, 3), np.float32)
    materials = (layers["albedo"], layers["roughness"], layers["metallic"])
    return Prediction(GBuffer(camera, alpha, none[..., 0], none, none, *materials), np.zeros((*alpha.shape, 4), np.float32))


def _albedo(albedo: np.ndarray, scale, alpha: np.ndarray) -> np.ndarray:
    """Return an encoded image of albedo on black."""
    return visualisation.over(visualisation.colour(albedo * np.asarray(scale), alpha), 0.0)


def _map(light: np.ndarray) -> np.ndarray:
    """Return an encoded image of a light map at a common mean brightness."""
    return np.round(255 * encode_srgb(np.clip(0.5 * light / light.mean(), 0, 1))).astype(np.uint8)


# --- report


def blocks(results: Results) -> Iterator[Block]:
    """Yield the table of all scenes, and the images of albedo and light."""
    rows = [
        [r.scene, r.configuration.removeprefix(PREFIX), r.figures["seconds"], r.counted.get("iterations"), *map(r.figures.get, FIGURES)]
        for r in results.records(prefix=PREFIX)
    ]
    if not rows:
        return
    yield Note(
        "Mitsuba gets our mesh, and whether the first stage takes the object for metal. Adam by path replay (prb) on the vertices' "
        f"albedo, roughness and metallic and on the logarithm of a {ROWS}-row light: {PIXELS} random pixels of all photographs at "
        f"{SAMPLES} samples an iteration, {BOUNCES} bounce of indirect light, our BRDF, our loss; with another seed where it crashes. Its "
        f"seconds are without compiling. New and relit views are {SHADED} test views, by the renderer of each."
    )
    yield Table("Materials and light at equal time, the shape given", ["scene", "by", "seconds", "iterations", *UNITS], rows)
    shown = [[(f"{r.scene}: {name}", file) for name, file in r.images.items()] for r in results.records(prefix=PREFIX)]
    yield Images("Albedo after the scale, and light", shown)
