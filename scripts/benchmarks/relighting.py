# SPDX-License-Identifier: GPL-3.0-or-later
"""Section on relighting: error over time and samples, the effect of each part of the method, and frame rates."""

# pyright: reportMissingImports=false
# (`irgspp` is the folder above, known to pyright under no name)

from __future__ import annotations

import itertools
from collections.abc import Iterator
from functools import partial

import numpy as np
import torch
from irgspp.core.evaluation import metrics, visualisation
from irgspp.core.relight.mesh_query import MeshQuery
from irgspp.core.relight.relighter import Relighter
from irgspp.core.relight.secondary_query import Hits, SurfaceQuery

from .bench import Bench, Scene
from .section import Block, Chart, Images, Measurement, Note, Series, Table, Task
from .store import Results
from .studio import RelightVariant, studio
from .timing import medians

NAME = "relighting"
TITLE = "Relighting: error against time and samples"
ABOUT = (
    "A view under a new light. Error: root mean square over the object's pixels against the converged image of the same renderer "
    "(not denoised). Seconds of a frame: from the camera to the image, on a run that is loaded. full: multiple importance sampling "
    "(MIS), denoised, secondary rays on the mesh. Without MIS: strata of the hemisphere; without mesh: secondary rays on the Gaussians."
)
ONCE = False
COUNTS, QUICK_COUNTS = (16, 32, 64, 128, 256, 512), (16, 64, 256)
MANY = 1024  # samples without MIS, compared with 16 with it


VARIANTS = {
    "full": RelightVariant(),
    "without denoiser": RelightVariant(denoise="off"),
    "without MIS": RelightVariant(sampling="stratified"),
    "without mesh": RelightVariant(backend="gaussian"),
    "with neither MIS nor denoiser": RelightVariant(denoise="off", sampling="stratified"),
    "with the paper's denoiser": RelightVariant(denoise="paper"),
}
MAIN = tuple(VARIANTS)[:3]  # variants whose images the report shows
TO_ERROR, ERRORS = "to an error", (0.02, 0.01, 0.005, 0.0025)
PLAIN = "with neither MIS nor denoiser"
SPEEDS = {"mesh": "mesh", "gaussian": "gaussian"}


def tasks(bench: Bench, scene: Scene | None) -> Iterator[Task]:
    """Yield the measurements of relighting a scene.

    Args:
        bench: options, scenes and reconstructions.
        scene: scene to measure.
    """
    assert scene is not None
    if not (scene.relights and bench.in_detail(scene)):
        return
    run, counts = [bench.balanced()], QUICK_COUNTS if bench.quick else COUNTS
    for variant, samples in itertools.product(VARIANTS, counts):
        expected = (samples / 512 * {"mesh": 5.0, "gaussian": 14.0}[VARIANTS[variant].backend] + 0.5) / (10 if bench.quick else 1)
        yield Task(f"{variant}, {samples} samples", partial(_point, bench, scene, variant, samples), expected, run)
    yield Task(f"{PLAIN}, {MANY} samples", partial(_point, bench, scene, PLAIN, MANY), 1.0 if bench.quick else 20.0, run)
    for error in ERRORS[: 2 if bench.quick else None]:
        yield Task(f"{TO_ERROR}, {error}", partial(_to_error, bench, scene, error), 4.0, run)
    for indirect in ("on", "off"):
        yield Task(f"indirect {indirect}", partial(_indirect, bench, scene, indirect == "on"), 1.0, run)
    yield Task("speed", partial(_speed, bench, scene), 5.0, run)
    yield Task("rays", partial(_rays, bench, scene), 4.0, run)
    yield Task("pictures", partial(_shown, bench, scene), 2.0, run)


def _point(bench: Bench, scene: Scene, variant: str, samples: int) -> Measurement:
    """Measure error and time of a variant with a number of samples."""
    one, how = studio(bench, scene), VARIANTS[variant]
    figures = one.errors(how, samples) | {"seconds": one.seconds(how, samples, bench.repeats)}
    pixels = len(one.relighter(how, samples).surface(one.lit_views[0].view.camera).index)
    return Measurement({"samples": samples, **figures}, {"pixels": pixels, "rays": pixels * samples})


def _to_error(bench: Bench, scene: Scene, error: float) -> Measurement:
    """Measure how many samples per pixel `--error` takes to reach an error, and which error it reaches."""
    one, variant = studio(bench, scene), RelightVariant(error=error)
    figures = one.errors(variant, 16) | {"seconds": one.seconds(variant, 16, bench.repeats), "asked": error}
    relighter = one.relighter(variant, 16)
    relighter.relit(relighter.surface(one.lit_views[0].view.camera), one.lit_views[0].prepared)
    counted = {"pixels": relighter.tally["pixels"], "rays": relighter.tally["traced"]}
    return Measurement({"samples": relighter.tally["samples"] / max(1, relighter.tally["pixels"]), **figures}, counted)


def _indirect(bench: Bench, scene: Scene, indirect: bool) -> Measurement:
    """Measure the error against the true images, with the albedo scale that `evaluate` finds: only then does brightness count."""
    one, run = studio(bench, scene), bench.run(scene, bench.balanced())
    scale = bench.evaluation(scene, run.path)["albedo_scale"]
    values = []
    for lit_view in one.lit_views:
        relighter = one.relighter(RelightVariant(indirect=indirect), 256).with_albedo_scale(scale)
        ours = metrics.on_black(relighter.relit(relighter.surface(lit_view.view.camera), lit_view.prepared).numpy())
        values.append(metrics.psnr(ours, lit_view.true))
    return Measurement({"true_psnr": float(np.mean(values))})


def _speed(bench: Bench, scene: Scene) -> Measurement:
    """Measure the frame rate at the setting for interaction."""
    one, figures = studio(bench, scene), {}
    for backend in ("mesh", "gaussian"):
        variant = RelightVariant(backend)
        figures[f"{backend}_seconds"] = one.seconds(variant, "efficient", bench.repeats)
        figures[f"{backend}_turned_seconds"] = one.turned_seconds(variant, "efficient", bench.repeats)
    camera = one.lit_views[0].view.camera
    return Measurement(
        figures, {"pixels": camera.width * camera.height, "samples": sum(one.relighter(RelightVariant(), "efficient").counts)}
    )


class _Recorder:
    """Mesh as `SurfaceQuery` that records its ray queries."""

    def __init__(self, query: SurfaceQuery) -> None:
        self._query, self.origins = query, query.origins
        self.queries: list[tuple[str, torch.Tensor, torch.Tensor]] = []

    def hits(self, origin: torch.Tensor, direction: torch.Tensor) -> Hits:
        """Record and answer a query of the closest hits."""
        self.queries.append(("hits", origin, direction))
        return self._query.hits(origin, direction)

    def hidden(self, origin: torch.Tensor, direction: torch.Tensor, reach: torch.Tensor | None = None) -> torch.Tensor:
        """Record and answer a query of occlusion."""
        self.queries.append(("hidden", origin, direction))
        return self._query.hidden(origin, direction, reach)


def _rays(bench: Bench, scene: Scene) -> Measurement:
    """Repeat the rays of a frame, through the mesh's query and through Embree alone in as many threads."""
    one, lit_view = studio(bench, scene).relighter(RelightVariant(), "efficient"), studio(bench, scene).lit_views[0]
    mesh, recorder = one.query, _Recorder(one.query)
    assert isinstance(mesh, MeshQuery)
    watched = Relighter(one.reconstruction, recorder, one.settings, one.mesh)
    watched.relit(watched.surface(lit_view.view.camera), lit_view.prepared)
    alone = {"hits": mesh.closest, "hidden": mesh.hidden}  # Embree answers occlusion directly
    works = {
        "frame": lambda: one.relit(one.surface(lit_view.view.camera), lit_view.prepared),
        "query": lambda: [getattr(mesh, question)(*rays) for question, *rays in recorder.queries],
        "embree": lambda: [alone[question](*rays) for question, *rays in recorder.queries],
    }
    found = medians(works, bench.repeats)
    rays = sum(len(origin) for _, origin, _ in recorder.queries)
    figures = {f"{name}_seconds": seconds for name, seconds in found.items()}
    return Measurement({**figures, "embree_mrays_per_second": rays / found["embree"] / 1e6}, {"rays": rays})


def _shown(bench: Bench, scene: Scene) -> Measurement:
    """Render 16 samples by each variant, next to the true image."""
    one = studio(bench, scene)
    lit_view, shown = one.lit_views[0], {"true": one.lit_views[0].true, "converged": one.converged("mesh", 0)}
    shown |= {f"{variant}, 16 samples": one.image(VARIANTS[variant], 16, lit_view) for variant in MAIN}
    error = visualisation.heat(np.abs(shown["full, 16 samples"] - shown["converged"]).max(-1), 0.2)[..., :3]
    shown["full to converged, error to 0.2"] = error
    return Measurement({"light": lit_view.light}, {}, {n: np.round(255 * p.clip(0, 1)).astype(np.uint8) for n, p in shown.items()})


# --- report


def blocks(results: Results) -> Iterator[Block]:
    """Yield the charts, tables and images of the report."""
    scenes = [scene for scene in results.scenes if any(results.records(scene, "full, "))]
    if scenes:
        panels = {scene: [_series(results, scene, variant, "seconds") for variant in (*VARIANTS, TO_ERROR)] for scene in scenes}
        label = "error (rms of encoded values) ↓"
        yield Chart("Error against time of a frame", "seconds a frame ↓", label, panels, image="benchmark_relighting")
        panels = {scene: [_series(results, scene, variant, "samples") for variant in VARIANTS] for scene in scenes}
        yield Chart("Error against samples a pixel", "samples a pixel", label, panels)
    for scene in scenes:
        yield _table(results, scene)
    yield from _summaries(results)
    shown = [[(f"{r.scene}: {name}", file) for name, file in r.images.items()] for r in results.records(prefix="pictures")]
    if shown:
        yield Images("A view under a new light", shown)


def _points(results: Results, scene: str, variant: str) -> list[dict]:
    """Return the metrics of a variant on a scene, in the order of its samples."""
    found = [r.figures for r in results.records(scene, f"{variant}, ")]
    return sorted(found, key=lambda figures: figures["samples"])


def _series(results: Results, scene: str, variant: str, x: str) -> Series:
    """Return the error of a variant as a curve over seconds or samples."""
    points = _points(results, scene, variant)
    return Series(variant, [p[x] for p in points], [p["rms_error"] for p in points])


def _table(results: Results, scene: str) -> Table:
    """Return the table of PSNR and time by samples per pixel."""
    counts = sorted({p["samples"] for variant in VARIANTS for p in _points(results, scene, variant)})
    rows = []
    for variant in VARIANTS:
        known = {p["samples"]: p for p in _points(results, scene, variant)}
        row = [f"{known[n]['converged_psnr']:.1f} dB, {1000 * known[n]['seconds']:.0f} ms" if n in known else None for n in counts]
        rows.append([variant, *row])
    return Table(f"{scene}: PSNR to the converged image ↑, and time of a frame ↓, by samples a pixel", ["", *map(str, counts)], rows)


def _summaries(results: Results) -> Iterator[Block]:
    """Yield the tables that compare few samples with many, errors asked for, frame rates and rays."""
    rows = []
    for scene in results.scenes:
        few, many = (
            results.figure(scene, f"{variant}, {n} samples", "rms_error") for variant, n in (("without denoiser", 16), (PLAIN, MANY))
        )
        fast = results.figure(scene, "full, 16 samples", "rms_error")
        on, off = (results.figure(scene, f"indirect {variant}", "true_psnr") for variant in ("on", "off"))
        slope = _slope(_points(results, scene, "without denoiser"))
        rows.append([scene, few, fast, many, slope, on, off])
    columns = (
        "scene",
        "16 with MIS, rms ↓",
        "16 full, rms ↓",
        f"{MANY} without MIS, rms ↓",
        "slope (−0.5: Monte Carlo)",
        "with indirect dB ↑",
        "without dB ↑",
    )
    if rows:
        yield Table("Few samples by MIS against many without; effect of indirect light, against the ground truth", columns, rows)
        yield Note(
            f"The paper: 16 samples with MIS are better than {MANY} without on its Teapot. Strata converge faster than plain Monte Carlo."
        )
    asked = [
        [r.scene, *(r.figures[name] for name in ("asked", "rms_error", "samples", "seconds"))] for r in results.records(prefix=TO_ERROR)
    ]
    if asked:
        columns = ("scene", "error asked for", "error reached ↓", "samples", "seconds ↓")
        yield Table("Rendered to an error (--error): as many samples a pixel as it needs", columns, asked)
    speeds = [
        [r.scene, *(1 / r.figures[f"{b}{turned}_seconds"] for b in SPEEDS for turned in ("", "_turned"))]
        for r in results.records(prefix="speed")
    ]
    if speeds:
        columns = ("scene", "mesh ↑", "mesh, light turned ↑", "Gaussians ↑", "Gaussians, light turned ↑")
        yield Table("Frames a second at --samples efficient", columns, speeds)
    rays = [(r.scene, r.counted["rays"], r.figures) for r in results.records(prefix="rays")]
    if rays:
        columns = ("scene", "rays a frame", "frame s ↓", "its rays by the relighter's query s ↓", "by Embree alone s ↓", "Embree, Mray/s ↑")
        names = ("frame_seconds", "query_seconds", "embree_seconds", "embree_mrays_per_second")
        yield Table("Time of a frame and of its rays", columns, [[scene, n, *(f[name] for name in names)] for scene, n, f in rays])


def _slope(points: list[dict]) -> float | None:
    """Return the slope of log error over log samples."""
    if len(points) < 2:
        return None
    x, y = (np.log([p[name] for p in points]) for name in ("samples", "rms_error"))
    return float(np.polyfit(x, y, 1)[0])
