# SPDX-License-Identifier: GPL-3.0-or-later
"""Relighting: error against time and samples, with and without each of its parts, and how fast frames come."""

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
from .studio import Way, studio
from .timing import medians

NAME = "relighting"
TITLE = "Relighting: error against time and samples"
ABOUT = (
    "A view under a new light. Error: root mean square over the object's pixels against the converged image of the same renderer "
    "(not denoised). Seconds of a frame: all of it, from the camera on, on a run that is open. full: multiple importance sampling "
    "(MIS), denoised, secondary rays on the mesh. Without MIS: strata of the hemisphere; without mesh: secondary rays on the Gaussians."
)
ONCE = False
COUNTS, QUICK_COUNTS = (16, 32, 64, 128, 256, 512), (16, 64, 256)
MANY = 1024  # samples without MIS that 16 with it are set beside


WAYS = {
    "full": Way(),
    "without denoiser": Way(denoise="off"),
    "without MIS": Way(sampling="stratified"),
    "without mesh": Way(backend="gaussian"),
    "with neither MIS nor denoiser": Way(denoise="off", sampling="stratified"),
    "with the paper's denoiser": Way(denoise="paper"),
}
MAIN = tuple(WAYS)[:3]  # of the images that are shown
TO_ERROR, ERRORS = "to an error", (0.02, 0.01, 0.005, 0.0025)
PLAIN = "with neither MIS nor denoiser"
SPEEDS = {"mesh": "mesh", "gaussian": "gaussian"}


def tasks(bench: Bench, scene: Scene | None) -> Iterator[Task]:
    assert scene is not None
    if not scene.relights:
        return
    run, counts = [bench.balanced()], QUICK_COUNTS if bench.quick else COUNTS
    for way, samples in itertools.product(WAYS, counts):
        expected = (samples / 512 * {"mesh": 5.0, "gaussian": 14.0}[WAYS[way].backend] + 0.5) / (10 if bench.quick else 1)
        yield Task(f"{way}, {samples} samples", partial(_point, bench, scene, way, samples), expected, run)
    yield Task(f"{PLAIN}, {MANY} samples", partial(_point, bench, scene, PLAIN, MANY), 1.0 if bench.quick else 20.0, run)
    for error in ERRORS[: 2 if bench.quick else None]:
        yield Task(f"{TO_ERROR}, {error}", partial(_to_error, bench, scene, error), 4.0, run)
    for indirect in ("on", "off"):
        yield Task(f"indirect {indirect}", partial(_indirect, bench, scene, indirect == "on"), 1.0, run)
    yield Task("speed", partial(_speed, bench, scene), 5.0, run)
    yield Task("rays", partial(_rays, bench, scene), 4.0, run)
    yield Task("pictures", partial(_shown, bench, scene), 2.0, run)


def _point(bench: Bench, scene: Scene, way: str, samples: int) -> Measurement:
    one, how = studio(bench, scene), WAYS[way]
    figures = one.errors(how, samples) | {"seconds": one.seconds(how, samples, bench.repeats)}
    pixels = len(one.relighter(how, samples).surface(one.places[0].view.camera).index)
    return Measurement({"samples": samples, **figures}, {"pixels": pixels, "rays": pixels * samples})


def _to_error(bench: Bench, scene: Scene, error: float) -> Measurement:
    """As many samples as an error takes, tile by tile; `samples` is their mean."""
    one, way = studio(bench, scene), Way(error=error)
    figures = one.errors(way, 16) | {"seconds": one.seconds(way, 16, bench.repeats), "asked": error}
    relighter = one.relighter(way, 16)
    relighter.relit(relighter.surface(one.places[0].view.camera), one.places[0].prepared)
    counted = {"pixels": relighter.tally["pixels"], "rays": relighter.tally["traced"]}
    return Measurement({"samples": relighter.tally["samples"] / max(1, relighter.tally["pixels"]), **figures}, counted)


def _indirect(bench: Bench, scene: Scene, indirect: bool) -> Measurement:
    """Against the true images, with the albedo's scale that `evaluate` finds: only then does brightness say something."""
    one, run = studio(bench, scene), bench.run(scene, bench.balanced())
    scale = bench.evaluation(scene, run.path)["albedo_scale"]
    values = []
    for place in one.places:
        relighter = one.relighter(Way(indirect=indirect), 256).scaled(scale)
        ours = metrics.on_black(relighter.relit(relighter.surface(place.view.camera), place.prepared).numpy())
        values.append(metrics.psnr(ours, place.true))
    return Measurement({"true_psnr": float(np.mean(values))})


def _speed(bench: Bench, scene: Scene) -> Measurement:
    """Frames at the setting for interaction."""
    one, figures = studio(bench, scene), {}
    for backend in ("mesh", "gaussian"):
        way = Way(backend)
        figures[f"{backend}_seconds"] = one.seconds(way, "efficient", bench.repeats)
        figures[f"{backend}_turned_seconds"] = one.turned_seconds(way, "efficient", bench.repeats)
    camera = one.places[0].view.camera
    return Measurement(figures, {"pixels": camera.width * camera.height, "samples": sum(one.relighter(Way(), "efficient").counts)})


class _Recorder:
    """A mesh as `SurfaceQuery` that notes what it is asked."""

    def __init__(self, query: SurfaceQuery) -> None:
        self._query, self.origins = query, query.origins
        self.asked: list[tuple[str, torch.Tensor, torch.Tensor]] = []

    def hits(self, origin: torch.Tensor, direction: torch.Tensor) -> Hits:
        self.asked.append(("hits", origin, direction))
        return self._query.hits(origin, direction)

    def hidden(self, origin: torch.Tensor, direction: torch.Tensor) -> torch.Tensor:
        self.asked.append(("hidden", origin, direction))
        return self._query.hidden(origin, direction)


def _rays(bench: Bench, scene: Scene) -> Measurement:
    """The rays of a frame again: through the mesh's query, and through Embree alone in as many threads."""
    one, place = studio(bench, scene).relighter(Way(), "efficient"), studio(bench, scene).places[0]
    mesh, recorder = one.query, _Recorder(one.query)
    assert isinstance(mesh, MeshQuery)
    watched = Relighter(one.reconstruction, recorder, one.settings, one.mesh)
    watched.relit(watched.surface(place.view.camera), place.prepared)
    alone = {"hits": mesh.closest, "hidden": mesh.hidden}  # whether a ray is hidden Embree says by itself
    works = {
        "frame": lambda: one.relit(one.surface(place.view.camera), place.prepared),
        "query": lambda: [getattr(mesh, question)(*rays) for question, *rays in recorder.asked],
        "embree": lambda: [alone[question](*rays) for question, *rays in recorder.asked],
    }
    found = medians(works, bench.repeats)
    rays = sum(len(origin) for _, origin, _ in recorder.asked)
    figures = {f"{name}_seconds": seconds for name, seconds in found.items()}
    return Measurement({**figures, "embree_mrays_per_second": rays / found["embree"] / 1e6}, {"rays": rays})


def _shown(bench: Bench, scene: Scene) -> Measurement:
    """16 samples by each way beside the true image."""
    one = studio(bench, scene)
    place, shown = one.places[0], {"true": one.places[0].true, "converged": one.converged("mesh", 0)}
    shown |= {f"{way}, 16 samples": one.image(WAYS[way], 16, place) for way in MAIN}
    error = visualisation.heat(np.abs(shown["full, 16 samples"] - shown["converged"]).max(-1), 0.2)[..., :3]
    shown["full to converged, error to 0.2"] = error
    return Measurement({"light": place.light}, {}, {n: np.round(255 * p.clip(0, 1)).astype(np.uint8) for n, p in shown.items()})


# --- what is shown


def blocks(results: Results) -> Iterator[Block]:
    scenes = [scene for scene in results.scenes if any(results.records(scene, "full, "))]
    if scenes:
        panels = {scene: [_series(results, scene, way, "seconds") for way in (*WAYS, TO_ERROR)] for scene in scenes}
        label = "error (rms of encoded values) ↓"
        yield Chart("Error against time of a frame", "seconds a frame ↓", label, panels, image="benchmark_relighting")
        panels = {scene: [_series(results, scene, way, "samples") for way in WAYS] for scene in scenes}
        yield Chart("Error against samples a pixel", "samples a pixel", label, panels)
    for scene in scenes:
        yield _table(results, scene)
    yield from _summaries(results)
    shown = [[(f"{r.scene}: {name}", file) for name, file in r.images.items()] for r in results.records(prefix="pictures")]
    if shown:
        yield Images("A view under a new light", shown)


def _points(results: Results, scene: str, way: str) -> list[dict]:
    found = [r.figures for r in results.records(scene, f"{way}, ")]
    return sorted(found, key=lambda figures: figures["samples"])


def _series(results: Results, scene: str, way: str, x: str) -> Series:
    points = _points(results, scene, way)
    return Series(way, [p[x] for p in points], [p["rms_error"] for p in points])


def _table(results: Results, scene: str) -> Table:
    counts = sorted({p["samples"] for way in WAYS for p in _points(results, scene, way)})
    rows = []
    for way in WAYS:
        known = {p["samples"]: p for p in _points(results, scene, way)}
        row = [f"{known[n]['converged_psnr']:.1f} dB, {1000 * known[n]['seconds']:.0f} ms" if n in known else None for n in counts]
        rows.append([way, *row])
    return Table(f"{scene}: PSNR to the converged image ↑, and time of a frame ↓, by samples a pixel", ["", *map(str, counts)], rows)


def _summaries(results: Results) -> Iterator[Block]:
    rows = []
    for scene in results.scenes:
        few, many = (results.figure(scene, f"{way}, {n} samples", "rms_error") for way, n in (("without denoiser", 16), (PLAIN, MANY)))
        fast = results.figure(scene, "full, 16 samples", "rms_error")
        on, off = (results.figure(scene, f"indirect {way}", "true_psnr") for way in ("on", "off"))
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
        yield Table(
            "Few samples well placed against many; whether light between the object's parts helps, against the truth", columns, rows
        )
        yield Note(
            f"The paper: 16 samples with MIS are better than {MANY} without on its Teapot. Strata converge faster than plain Monte Carlo."
        )
    asked = [
        [r.scene, *(r.figures[name] for name in ("asked", "rms_error", "samples", "seconds"))] for r in results.records(prefix=TO_ERROR)
    ]
    if asked:
        columns = ("scene", "error asked for", "error reached ↓", "mean samples", "seconds ↓")
        yield Table("Rendered to an error (--error): every tile gets the samples that it takes", columns, asked)
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
        yield Table("Where a frame's time goes", columns, [[scene, n, *(f[name] for name in names)] for scene, n, f in rays])


def _slope(points: list[dict]) -> float | None:
    """Of log error over log samples."""
    if len(points) < 2:
        return None
    x, y = (np.log([p[name] for p in points]) for name in ("samples", "rms_error"))
    return float(np.polyfit(x, y, 1)[0])
