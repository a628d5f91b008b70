# SPDX-License-Identifier: GPL-3.0-or-later
"""Evaluation of a run: all metrics that the dataset's ground truth allows, as a table, JSON and an HTML page with images."""

from __future__ import annotations

import json
import time
from collections.abc import Iterator
from dataclasses import asdict, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from ..errors import Cancelled, InputError
from ..io.atomic import write_atomic
from ..progress.protocol import Progress, Silent
from ..relight.backends import Backend, best_backend, open_relighter
from ..relight.prepared_light import PreparedLight, prepare_light
from ..relight.relight_settings import RelightSettings
from ..relight.relighter import Relighter
from ..rendering.trusted_device import trusted_device
from ..scene.mesh_ply import load_mesh_ply
from ..scene.reconstruction import Reconstruction
from ..settings.schema import DataSettings
from ..shading.environment_lookup import turned
from . import metrics
from .calibration import Calibration
from .cases import Case, Cases, read_cases, spread
from .conditions import describe_conditions, describe_renderer
from .cycles import compare
from .ground_truth import SceneTruth, Truth
from .html_report import SHOWN, page, png_bytes
from .light_comparison import PICTURES, LightComparison, compare_lights
from .lpips import Lpips, find_lpips
from .mesh_normals import mesh_normals
from .prediction import Prediction
from .protocols import PLAIN, Protocol, describe_protocol, protocol_named
from .view_metrics import Fits, averages, fitted_metrics, mesh_metrics, relit_metrics, view_metrics

CHAMFER_UNIT = 2000  # factor of Stanford-ORB's tables
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
    relight: RelightSettings | None = None,
    backend: Backend | None = None,
    device: str = "auto",
) -> dict[str, Any]:
    """Compare a run with the test views of a dataset (its training views where it has no others).

    Writes `report.json`, `report.html` (self-contained) and the pictures of the light, see `LightComparison.pictures`.

    Args:
        run: folder of the finished run.
        dataset: folder or file.
        output: folder of the report; `run/evaluation` where it is None.
        settings: of reading the dataset.
        progress: reporter; asked between two views whether to stop.
        cycles: number of views that Cycles renders too, from the asset, under the known lights (the recovered one where none is known).
        protocol: name of one of PROTOCOLS, see protocols.py.
        views: number of views, evenly spread; None: all.
        samples: light samples per pixel; None: the protocol's.
        lpips: LPIPS network as a TorchScript file; None: the package lpips, where it is installed.
        relight: settings of the relit images; the number of samples is the protocol's. None: the defaults.
        backend: what secondary rays are traced on; None: the mesh where the run has one.
        device: to compute on, see `choose_device`.

    Returns:
        Content of the JSON: "figures" (means over the views), "views" (the same per view), "albedo_scale" (3 numbers or None), "split",
        "calibration" (confidence and error of materials and light, see `Calibration.curves`), "novel" (number of views under other lights),
        "cycles" (metrics of each comparison), "run", "dataset", "protocol" (a line of text for each choice), "choices" (the same for
        programs).

    Raises:
        InputError: when the folder is not a finished run, or the dataset can't be read.
        NoBlender: when Cycles is asked for and no Blender is found.
        Cancelled: when the user stops the work.
    """
    progress = progress or Silent()
    choices = protocol_named(protocol)
    choices = choices if samples is None else replace(choices, samples=samples)
    distances = {"": found} if lpips is not None and (found := find_lpips(lpips)) else _distances(choices)
    reconstruction = Reconstruction.load(run).to(trusted_device(device).device)
    cases = read_cases(reconstruction, dataset, settings or DataSettings(), progress, choices.relit_views, views)
    backend = backend or best_backend(run)
    relight = replace(relight or RelightSettings(), samples=choices.samples)
    relighter = open_relighter(run, reconstruction, backend, relight)
    evaluation = Evaluation(cases, relighter, choices, distances, progress)
    evaluation.compare()
    true_light = cases.scene.lights.get(cases.scene.train_light or "", evaluation.own_light)
    light = compare_lights(run, reconstruction, true_light, choices.light_grid)
    if light.error is not None:
        evaluation.calibration.gather_light(light.confidence, light.error)
    report = evaluation.summary()
    report["figures"] |= light.figures | shape_metrics(run, cases.scene, choices, cases.unit)
    lights = cases.scene.lights or {"recovered": reconstruction.environment_map()}
    cameras = {cases.names[i]: cases.cameras[i] for i in spread(cases.own, cycles)}
    asset = compare(relighter, run, cameras, lights, progress) if cycles else []
    report["figures"] |= averages([one.metrics for one in asset], ())
    report["cycles"] = [{"view": one.view, "light": one.light, **one.metrics} for one in asset]
    report |= {
        "run": str(run.resolve()),
        "dataset": str(dataset.resolve()),
        "split": cases.split,
        "choices": {name: list(value) if isinstance(value, tuple) else value for name, value in asdict(choices).items()},
    }
    renderer = describe_renderer(relight, backend, relight.brdf or reconstruction.brdf)
    conditions = describe_conditions(cases, choices, distances, report["albedo_scale"], renderer)
    report["protocol"] = [*describe_protocol(choices), light.description, *conditions, *([CYCLES_PROTOCOL] if cycles else [])]
    _write(output or run / "evaluation", report, page(report, evaluation.shown, choices, asset, light), light)
    return report


def _distances(protocol: Protocol) -> dict[str, Lpips]:
    """Load the protocol's LPIPS networks by the suffix of the metrics' names, which is empty for the first one."""
    found = {"" if name == protocol.lpips[0] else f"_{name}": find_lpips(None, name) for name in protocol.lpips}
    return {suffix: one for suffix, one in found.items() if one is not None}


class Evaluation:
    """Comparison of a run's views with their ground truth, in two passes: the first one fits the scales common to all views.

    Args:
        cases: views to compare.
        relighter: of the run.
        protocol: of the comparison.
        lpips: perceptual distances by the suffix of the metrics' names.
        progress: reporter; asked between two views whether to stop.
    """

    def __init__(self, cases: Cases, relighter: Relighter, protocol: Protocol, lpips: dict[str, Lpips], progress: Progress) -> None:
        self.cases, self.relighter, self.protocol, self.lpips, self.progress = cases, relighter, protocol, lpips, progress
        self.fits, self.rows = Fits(protocol), [dict[str, float]() for _ in cases.views]
        self.shown: dict[str, tuple[Prediction, Truth]] = {}  # views shown in the report, with all their images
        self.lit_by: dict[str, None] = {}  # names of lights, in order
        self.seconds: list[float] = []  # of each image under the recovered light
        self.calibration = Calibration()
        self.own_light: np.ndarray | None = None  # true light of the first view, where it is known view by view
        self._prepared: dict[str, PreparedLight] = {}

    def compare(self) -> None:
        """Compare all views; raises Cancelled between two views when the user stops the work."""
        shown = spread(len(self.cases.views), SHOWN)
        first = {case.number: self._compare_unscaled(case, case.number in shown) for case in self._each_case("evaluate")}
        relighter = self.relighter.with_albedo_scale(self.fits.albedo if self.protocol.relit_scaled else None)
        for case in self._each_case("relight"):
            unlit = first.pop(case.number) or Prediction(relighter.gbuffer(case.camera, light_rotation=case.view.light_rotation), None)
            prediction = replace(unlit, relit=self._relit(relighter, case))
            row = self.rows[case.number]
            row |= relit_metrics(prediction, case.truth, self.protocol, self.lpips)
            row |= fitted_metrics(prediction, case.truth, self.fits, self.protocol, self.cases.unit, self.lpips)
            self.calibration.gather(prediction, case.truth, self.fits.albedo)
            self.lit_by |= dict.fromkeys(prediction.relit)
            if case.number in shown:
                self.shown[self.cases.names[case.number]] = prediction, case.truth

    def summary(self) -> dict[str, Any]:
        """Return the metrics of all views, and their means, under the keys of report.json."""
        relights, scale = [name for name in self.lit_by if name != self.cases.scene.train_light], self.fits.albedo
        return {
            "figures": averages(self.rows, relights, self.protocol) | self._speed() | self.calibration.figures(),
            "calibration": self.calibration.curves(),
            "views": dict(zip(self.cases.names, self.rows, strict=True)),
            "novel": len(self.cases.views) - self.cases.own,
            "albedo_scale": None if scale is None else [float(s) for s in scale],
        }

    def _speed(self) -> dict[str, float]:
        """Return the rate of images under the recovered light, by the median time of one."""
        return {"frames_per_second": 1 / max(float(np.median(self.seconds)), 1e-9)} if self.seconds else {}

    def _each_case(self, phase: str) -> Iterator[Case]:
        """Yield every view and report the progress."""
        count = len(self.cases.views)
        self.progress.phase(phase, count)
        for case in self.cases:
            yield case
            self.progress.step(case.number + 1)
            if self.progress.cancelled:
                raise Cancelled(f"stopped after {case.number + 1} of {count} views")

    def _compare_unscaled(self, case: Case, keep: bool) -> Prediction | None:
        """Compare the layers and the image under the recovered light; return the prediction where `keep` is set."""
        own, mesh = case.view.light is None, self.relighter.mesh
        buffers = self.relighter.gbuffer(case.camera, light_rotation=case.view.light_rotation)
        prediction = Prediction(buffers, self._shaded(case) if own else None)
        self.fits.gather(prediction, case.truth)
        self.rows[case.number] |= view_metrics(prediction, case.truth, self.protocol, self.lpips)
        if mesh is not None and case.truth.normal is not None:
            self.rows[case.number] |= mesh_metrics(*mesh_normals(mesh, case.camera), case.truth, self.protocol)
        if own and self.own_light is None:
            self.own_light = next(iter(case.truth.lights.values()), None)
        return prediction if keep else None

    def _shaded(self, case: Case) -> np.ndarray:
        """Render a view under the recovered light, turned as it was in the photograph, (H, W, 4), and measure the time."""
        rotation, light = case.view.light_rotation, self._recovered_light
        if rotation is not None:
            light = prepare_light(turned(self.relighter.reconstruction.environment_map(), rotation))
        began = time.perf_counter()
        image = self.relighter.relit(self.relighter.surface(case.camera), light).numpy()
        self.seconds.append(time.perf_counter() - began)
        return image

    @cached_property
    def _recovered_light(self) -> PreparedLight:
        return prepare_light(self.relighter.reconstruction.environment_map())

    def _relit(self, relighter: Relighter, case: Case) -> dict[str, np.ndarray]:
        """Render a view under every known light, (H, W, 4) each; none beyond the protocol's number of views."""
        known = case.truth.lights.keys() | self.cases.scene.lights.keys()
        names = [name for name in case.truth.relit if name in known]
        beyond = case.view.light is None and self.protocol.relit_views is not None and case.number >= self.protocol.relit_views
        if not names or beyond:
            return {}
        surface = relighter.surface(case.camera)
        return {name: relighter.relit(surface, self._light(case.truth, name)).numpy() for name in names}

    def _light(self, truth: Truth, name: str) -> PreparedLight:
        """Return a light of the view alone, or of the scene; the scene's are prepared once for all views."""
        if name in truth.lights:
            return prepare_light(truth.lights[name])
        if name not in self._prepared:
            self._prepared[name] = prepare_light(self.cases.scene.lights[name])
        return self._prepared[name]


def shape_metrics(run: Path, scene: SceneTruth, protocol: Protocol = PLAIN, unit: float = 1.0) -> dict[str, float]:
    """Return the metrics of the mesh, where the run has one and points of the true surface are known.

    Args:
        run: folder of the run.
        scene: ground truth of the scene.
        protocol: of the comparison.
        unit: length in the run's world frame of one unit of the dataset.
    """
    if scene.points is None or not (run / "mesh.ply").is_file():
        return {}
    mesh = load_mesh_ply(run / "mesh.ply")
    values = metrics.mesh_distances(mesh, *scene.points)
    if protocol.scale_free:
        values["shape_chamfer"] = CHAMFER_UNIT * metrics.squared_chamfer(mesh, scene.points[0]) / unit**2
    return values


def table(report: dict[str, Any]) -> str:
    """Return the mean metrics and the protocol of a report as aligned lines of text."""
    lines = [f"{name:28s} {metrics.format_metric(value):>10s}" for name, value in report["figures"].items()]
    if report["albedo_scale"]:
        lines.append(f"{'albedo_scale':28s} " + " ".join(f"{s:10.4f}" for s in report["albedo_scale"]))
    lines.append(f"{report['split'] + ' views':28s} {len(report['views']) - report['novel']:10d}")
    lines += [f"{'views under other lights':28s} {report['novel']:10d}"] if report["novel"] else []
    return "\n".join([*lines, *report["protocol"]])


def _write(folder: Path, report: dict[str, Any], html: str, light: LightComparison) -> None:
    """Write the pictures of the light, report.json and report.html, each atomically; pictures that an earlier report had are removed."""
    pictures = {f"{name}.png": png_bytes(image) for name, (_, image) in light.pictures().items()}
    texts = {"report.json": json.dumps(report, indent=1).encode(), "report.html": html.encode()}
    try:
        folder.mkdir(parents=True, exist_ok=True)
        for name in PICTURES:
            (folder / f"{name}.png").unlink(missing_ok=True)
        for name, data in (pictures | texts).items():
            write_atomic(folder / name, data)
    except OSError as error:
        raise InputError(folder, f"the report can't be written there ({error.strerror})", "choose another folder") from error
