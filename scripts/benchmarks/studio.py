# SPDX-License-Identifier: GPL-3.0-or-later
"""A run that is relit in all the ways that are compared, and the images that each way tends to."""

from __future__ import annotations

import itertools
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np
from irgspp.core.evaluation import metrics
from irgspp.core.relight.backends import Backend, open_relighter
from irgspp.core.relight.prepared_light import PreparedLight, prepare
from irgspp.core.relight.relighter import Relighter, RelightSettings
from irgspp.core.scene.dataset import View
from irgspp.core.scene.reconstruction import Reconstruction
from irgspp.core.settings.schema import SkipSettings

from .bench import Bench, Scene
from .timing import median_seconds

CONVERGED = {"mesh": 4096, "gaussian": 2048}  # samples
QUICK_CONVERGED = {"mesh": 1024, "gaussian": 1024}
PLACES = 2  # pairs of a view and a light that errors are means over


@dataclass(frozen=True)
class Way:
    """How images are made."""

    backend: Backend = "mesh"
    denoise: Literal["demodulated", "paper", "off"] = "demodulated"
    sampling: Literal["mis", "stratified"] = "mis"
    indirect: bool = True
    error: float | None = None  # that decides on the samples


@dataclass(frozen=True, eq=False)
class Place:
    """A view under a light, with its true image (H, W, 3) encoded, and where the object is."""

    view: View
    light: str
    prepared: PreparedLight
    true: np.ndarray
    inside: np.ndarray


class Studio:
    """A run and the places that it is relit at; converged images are made once."""

    def __init__(self, run: Path, places: list[Place], converged: dict[str, int]) -> None:
        self.run, self.places, self._converged = run, places, converged
        self.reconstruction = Reconstruction.load(run)
        self._images: dict[tuple[str, int], np.ndarray] = {}

    def relighter(self, way: Way, samples: str | int, skip: SkipSettings | None = None) -> Relighter:
        """With nothing remembered from other images."""
        rules = skip or SkipSettings()
        how = RelightSettings(samples, way.sampling, way.denoise, way.indirect, skip=rules, error=way.error)
        return open_relighter(self.run, self.reconstruction, way.backend, how)

    def image(self, way: Way, samples: str | int, place: Place) -> np.ndarray:
        """(H, W, 3) encoded, on black."""
        one = self.relighter(way, samples)
        return metrics.on_black(one.relit(one.surface(place.view.camera), place.prepared).numpy())

    def converged(self, backend: Backend, number: int) -> np.ndarray:
        """The image that a backend's images tend to."""
        if (backend, number) not in self._images:
            way = Way(backend, denoise="off")
            self._images[backend, number] = self.image(way, self._converged[backend], self.places[number])
        return self._images[backend, number]

    def errors(self, way: Way, samples: str | int) -> dict[str, float]:
        """Root mean square error and PSNR against the converged image, and PSNR against the true one; means over the places."""
        rows = []
        for number, place in enumerate(self.places):
            ours, limit = self.image(way, samples, place), self.converged(way.backend, number)
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
        _studios.clear()  # of scenes before: converged images and trees are large
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
