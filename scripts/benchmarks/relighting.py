# SPDX-License-Identifier: GPL-3.0-or-later
"""Relighting: error against time and samples, with and without each of its parts, and how fast frames come."""

# pyright: reportMissingImports=false
# (`irgspp` is the folder above, known to pyright under no name)

from __future__ import annotations

import itertools
from collections.abc import Iterator
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np
import torch
from irgspp.core.config import SkipSettings
from irgspp.core.datasets.dataset import View
from irgspp.core.evaluation import metrics, pictures
from irgspp.core.relight.backends import Backend, open_relighter
from irgspp.core.relight.lighting import PreparedLight, prepare
from irgspp.core.relight.mesh_query import MeshQuery
from irgspp.core.relight.query import Hits, SurfaceQuery
from irgspp.core.relight.relighter import Relighter, RelightSettings
from irgspp.core.scene.reconstruction import Reconstruction

from .bench import Bench, Scene
from .section import Block, Chart, Measurement, Note, Pictures, Series, Table, Task
from .store import Results
from .timing import median_seconds, medians

NAME = "relighting"
TITLE = "Relighting: error against time and samples"
ABOUT = (
    "A view under a new light. Error: root mean square over the object's pixels against the converged picture of the same renderer "
    "(not denoised). Seconds of a frame: all of it, from the camera on, on a run that is open. full: multiple importance sampling "
    "(MIS), denoised, secondary rays on the mesh. Without MIS: strata of the hemisphere; without mesh: secondary rays on the Gaussians."
)
ONCE = False
COUNTS, QUICK_COUNTS = (16, 32, 64, 128, 256, 512), (16, 64, 256)
CONVERGED = {"mesh": 4096, "gaussian": 2048}
QUICK_CONVERGED = {"mesh": 1024, "gaussian": 1024}
MANY = 1024  # samples without MIS that 16 with it are set beside
PLACES = 2  # pairs of a view and a light that errors are means over


@dataclass(frozen=True)
class Way:
    """How pictures are made."""

    backend: Backend = "mesh"
    denoise: str = "demodulated"
    sampling: str = "mis"
    indirect: bool = True
    error: float | None = None  # that decides on the samples


WAYS = {
    "full": Way(),
    "without denoiser": Way(denoise="off"),
    "without MIS": Way(sampling="stratified"),
    "without mesh": Way(backend="gaussian"),
    "with neither MIS nor denoiser": Way(denoise="off", sampling="stratified"),
    "with the paper's denoiser": Way(denoise="paper"),
}
MAIN = tuple(WAYS)[:3]  # of the pictures that are shown
TO_ERROR, ERRORS = "to an error", (0.02, 0.01, 0.005, 0.0025)
PLAIN = "with neither MIS nor denoiser"
SPEEDS = {"mesh": "mesh", "gaussian": "gaussian"}


@dataclass(frozen=True, eq=False)
class Place:
    """A view under a light, with its true picture (H, W, 3) encoded, and where the object is."""

    view: View
    light: str
    prepared: PreparedLight
    true: np.ndarray
    inside: np.ndarray


class Studio:
    """A run and the places that it is relit at; converged pictures are made once."""

    def __init__(self, run: Path, places: list[Place], converged: dict[str, int]) -> None:
        self.run, self.places, self._converged = run, places, converged
        self.reconstruction = Reconstruction.load(run)
        self._pictures: dict[tuple[str, int], np.ndarray] = {}

    def relighter(self, way: Way, samples: str | int, skip: SkipSettings | None = None) -> Relighter:
        """With nothing remembered from other pictures."""
        rules = skip or SkipSettings()
        how = RelightSettings(
            samples=samples, sampling=way.sampling, denoise=way.denoise, indirect=way.indirect, skip=rules, error=way.error
        )  # type: ignore
        return open_relighter(self.run, self.reconstruction, way.backend, how)

    def picture(self, way: Way, samples: str | int, place: Place) -> np.ndarray:
        """(H, W, 3) encoded, on black."""
        one = self.relighter(way, samples)
        return metrics.on_black(one.relit(one.surface(place.view.camera), place.prepared).numpy())

    def converged(self, backend: Backend, number: int) -> np.ndarray:
        """The picture that a backend's pictures tend to."""
        if (backend, number) not in self._pictures:
            way = Way(backend, denoise="off")
            self._pictures[backend, number] = self.picture(way, self._converged[backend], self.places[number])
        return self._pictures[backend, number]

    def errors(self, way: Way, samples: str | int) -> dict[str, float]:
        """Root mean square error and PSNR against the converged picture, and PSNR against the true one; means over the places."""
        rows = []
        for number, place in enumerate(self.places):
            ours, limit = self.picture(way, samples, place), self.converged(way.backend, number)
            rms = float(np.sqrt(np.square(ours - limit)[place.inside].mean()))
            rows.append((rms, metrics.psnr(ours, limit), metrics.psnr(ours, place.true)))
        rms, converged, true = np.mean(rows, 0)
        return {"rms_error": float(rms), "converged_psnr": float(converged), "true_psnr": float(true)}

    def seconds(self, way: Way, samples: str | int, repeats: int) -> float:
        """Of a frame whose camera and light are new."""
        one, place = self.relighter(way, samples), self.places[0]
        return median_seconds(lambda: one.relit(one.surface(place.view.camera), place.prepared), repeats)

    def turned_seconds(self, way: Way, samples: str | int, repeats: int) -> float:
        """Of a frame whose light alone is new."""
        one, lights = self.relighter(way, samples), itertools.cycle(place.prepared for place in self.places)
        surface = one.surface(self.places[0].view.camera)
        return median_seconds(lambda: one.relit(surface, next(lights)), repeats)


_studios: dict[Path, Studio] = {}


def studio(bench: Bench, scene: Scene, run: Path | None = None) -> Studio:
    """Of the balanced run of a scene, or of another run of it; kept while the benchmark is at it."""
    path = run or bench.run(scene, bench.balanced()).path
    if path not in _studios:
        _studios.clear()  # of scenes before: converged pictures and trees are large
        _studios[path] = Studio(path, places(scene), QUICK_CONVERGED if bench.quick else CONVERGED)
    return _studios[path]


def places(scene: Scene) -> list[Place]:
    """Test views far apart, each under another of the lights."""
    lights = scene.relights
    chosen = np.linspace(0, len(scene.views) - 1, PLACES + 1)[:-1].round().astype(int)
    found = []
    for number, index in enumerate(chosen):
        view, light = scene.views[index], lights[number % len(lights)]
        truth = scene.view_truth(view)
        found.append(Place(view, light, prepare(scene.truth.lights[light]), truth.relit[light], truth.object))
    return found


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
    """Against the true pictures, with the albedo's scale that `evaluate` finds: only then does brightness say something."""
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
        self.asked: list[tuple[torch.Tensor, torch.Tensor]] = []

    def hits(self, origin: torch.Tensor, direction: torch.Tensor) -> Hits:
        self.asked.append((origin, direction))
        return self._query.hits(origin, direction)


def _rays(bench: Bench, scene: Scene) -> Measurement:
    """The rays of a frame again: through the mesh's query, and through Embree alone in as many threads."""
    one, place = studio(bench, scene).relighter(Way(), "efficient"), studio(bench, scene).places[0]
    mesh, recorder = one.query, _Recorder(one.query)
    assert isinstance(mesh, MeshQuery)
    watched = Relighter(one.reconstruction, recorder, one.settings, one.mesh)
    watched.relit(watched.surface(place.view.camera), place.prepared)
    works = {
        "frame": lambda: one.relit(one.surface(place.view.camera), place.prepared),
        "query": lambda: [mesh.hits(*rays) for rays in recorder.asked],
        "embree": lambda: [mesh.closest(*rays) for rays in recorder.asked],
    }
    found = medians(works, bench.repeats)
    rays = sum(len(origin) for origin, _ in recorder.asked)
    figures = {f"{name}_seconds": seconds for name, seconds in found.items()}
    return Measurement({**figures, "embree_mrays_per_second": rays / found["embree"] / 1e6}, {"rays": rays})


def _shown(bench: Bench, scene: Scene) -> Measurement:
    """16 samples by each way beside the true picture."""
    one = studio(bench, scene)
    place, shown = one.places[0], {"true": one.places[0].true, "converged": one.converged("mesh", 0)}
    shown |= {f"{way}, 16 samples": one.picture(WAYS[way], 16, place) for way in MAIN}
    error = pictures.heat(np.abs(shown["full, 16 samples"] - shown["converged"]).max(-1), 0.2)[..., :3]
    shown["full to converged, error to 0.2"] = error
    return Measurement({"light": place.light}, {}, {n: np.round(255 * p.clip(0, 1)).astype(np.uint8) for n, p in shown.items()})


# --- what is shown


def blocks(results: Results) -> Iterator[Block]:
    scenes = [scene for scene in results.scenes if any(results.records(scene, "full, "))]
    if scenes:
        panels = {scene: [_series(results, scene, way, "seconds") for way in (*WAYS, TO_ERROR)] for scene in scenes}
        label = "error (rms of encoded values) ↓"
        yield Chart("Error against time of a frame", "seconds a frame ↓", label, panels, picture="benchmark_relighting")
        panels = {scene: [_series(results, scene, way, "samples") for way in WAYS] for scene in scenes}
        yield Chart("Error against samples a pixel", "samples a pixel", label, panels)
    for scene in scenes:
        yield _table(results, scene)
    yield from _summaries(results)
    shown = [[(f"{r.scene}: {name}", file) for name, file in r.pictures.items()] for r in results.records(prefix="pictures")]
    if shown:
        yield Pictures("A view under a new light", shown)


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
    return Table(f"{scene}: PSNR to the converged picture ↑, and time of a frame ↓, by samples a pixel", ["", *map(str, counts)], rows)


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
