# SPDX-License-Identifier: GPL-3.0-or-later
"""Relighting of a run in all variants that are compared, and the converged image of each."""

from __future__ import annotations

import itertools
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np
from irgspp.core.evaluation import metrics
from irgspp.core.relight.backends import Backend, open_relighter
from irgspp.core.relight.prepared_light import PreparedLight, prepare_light
from irgspp.core.relight.relight_settings import RelightSettings
from irgspp.core.relight.relighter import Relighter
from irgspp.core.scene.dataset import View
from irgspp.core.scene.reconstruction import Reconstruction
from irgspp.core.settings.schema import SkipSettings

from .bench import Bench, Scene
from .timing import median_seconds

CONVERGED = {"mesh": 4096, "gaussian": 2048}  # samples per pixel
QUICK_CONVERGED = {"mesh": 1024, "gaussian": 1024}
LIT_VIEWS = 2  # pairs of a view and a light that errors are means over


@dataclass(frozen=True)
class RelightVariant:
    """Options of relighting that are compared.

    Attributes:
        backend: "mesh" or "gaussian" for secondary rays.
        denoise: denoiser.
        sampling: "mis", or "stratified" for comparison.
        indirect: indirect light.
        error: error that decides on the number of samples; None: a fixed number.
        others: further fields of `RelightSettings` and their values.
    """

    backend: Backend = "mesh"
    denoise: Literal["demodulated", "paper", "off"] = "demodulated"
    sampling: Literal["mis", "stratified"] = "mis"
    indirect: bool = True
    error: float | None = None
    others: tuple[tuple[str, Any], ...] = ()


@dataclass(frozen=True, eq=False)
class LitView:
    """View under a light.

    Attributes:
        view: test view.
        light: name of the light.
        prepared: the light, prepared for relighting.
        true: true image (H, W, 3), encoded.
        inside: mask of the object (H, W).
    """

    view: View
    light: str
    prepared: PreparedLight
    true: np.ndarray
    inside: np.ndarray


class Studio:
    """Run to relight, and the lit views that errors are measured on; converged images are rendered once."""

    def __init__(self, run: Path, lit_views: list[LitView], converged: dict[str, int]) -> None:
        """Load a run.

        Args:
            run: run folder.
            lit_views: views and lights.
            converged: samples per pixel of the converged images by backend.
        """
        self.run, self.lit_views, self._converged = run, lit_views, converged
        self.reconstruction = Reconstruction.load(run)
        self._images: dict[tuple[str, int], np.ndarray] = {}

    def relighter(self, variant: RelightVariant, samples: str | int, skip: SkipSettings | None = None) -> Relighter:
        """Return a relighter without cached work of other images.

        Args:
            variant: options of relighting.
            samples: samples per pixel, "hq" or "efficient".
            skip: rules that skip work; None: the defaults.
        """
        rules = skip or SkipSettings()
        chosen = {"skip": rules, "error": variant.error, **dict(variant.others)}
        settings = RelightSettings(samples, variant.sampling, variant.denoise, variant.indirect, **chosen)
        return open_relighter(self.run, self.reconstruction, variant.backend, settings)

    def image(self, variant: RelightVariant, samples: str | int, lit_view: LitView) -> np.ndarray:
        """Relight a view.

        Args:
            variant: options of relighting.
            samples: samples per pixel, "hq" or "efficient".
            lit_view: view and light.

        Returns:
            (H, W, 3) encoded, on black.
        """
        one = self.relighter(variant, samples)
        return metrics.on_black(one.relit(one.surface(lit_view.view.camera), lit_view.prepared).numpy())

    def converged(self, backend: Backend, number: int) -> np.ndarray:
        """Return the image that a backend converges to, (H, W, 3) encoded.

        Args:
            backend: "mesh" or "gaussian".
            number: index of the lit view.
        """
        if (backend, number) not in self._images:
            variant = RelightVariant(backend, denoise="off")
            self._images[backend, number] = self.image(variant, self._converged[backend], self.lit_views[number])
        return self._images[backend, number]

    def errors(self, variant: RelightVariant, samples: str | int) -> dict[str, float]:
        """Measure root mean square error and PSNR against the converged image, and PSNR against the true one; means over the lit views.

        Args:
            variant: options of relighting.
            samples: samples per pixel, "hq" or "efficient".
        """
        rows = []
        for number, lit_view in enumerate(self.lit_views):
            ours, limit = self.image(variant, samples, lit_view), self.converged(variant.backend, number)
            rms = float(np.sqrt(np.square(ours - limit)[lit_view.inside].mean()))
            rows.append((rms, metrics.psnr(ours, limit), metrics.psnr(ours, lit_view.true)))
        rms, converged, true = np.mean(rows, 0)
        return {"rms_error": float(rms), "converged_psnr": float(converged), "true_psnr": float(true)}

    def seconds(self, variant: RelightVariant, samples: str | int, repeats: int) -> float:
        """Measure the time of a frame with a new camera and a new light, in seconds.

        Args:
            variant: options of relighting.
            samples: samples per pixel, "hq" or "efficient".
            repeats: repeats of the timing.
        """
        one, lit_view = self.relighter(variant, samples), self.lit_views[0]
        return median_seconds(lambda: one.relit(one.surface(lit_view.view.camera), lit_view.prepared), repeats)

    def turned_seconds(self, variant: RelightVariant, samples: str | int, repeats: int) -> float:
        """Measure the time of a frame with a new light alone, in seconds.

        Args:
            variant: options of relighting.
            samples: samples per pixel, "hq" or "efficient".
            repeats: repeats of the timing.
        """
        one, lights = self.relighter(variant, samples), itertools.cycle(lit_view.prepared for lit_view in self.lit_views)
        surface = one.surface(self.lit_views[0].view.camera)
        return median_seconds(lambda: one.relit(surface, next(lights)), repeats)


_studios: dict[Path, Studio] = {}


def studio(bench: Bench, scene: Scene, run: Path | None = None) -> Studio:
    """Return the studio of a scene's balanced run, or of another run of it; the last one is cached.

    Args:
        bench: options, scenes and reconstructions.
        scene: scene of the run.
        run: run folder; None: of the balanced run.
    """
    path = run or bench.run(scene, bench.balanced()).path
    if path not in _studios:
        _studios.clear()  # drop earlier ones: converged images and trees are large
        _studios[path] = Studio(path, lit_views(scene), QUICK_CONVERGED if bench.quick else CONVERGED)
    return _studios[path]


def lit_views(scene: Scene) -> list[LitView]:
    """Return test views far apart, each under another light."""
    lights = scene.relights
    chosen = np.linspace(0, len(scene.views) - 1, LIT_VIEWS + 1)[:-1].round().astype(int)
    found = []
    for number, index in enumerate(chosen):
        view, light = scene.views[index], lights[number % len(lights)]
        truth = scene.view_truth(view)
        found.append(LitView(view, light, prepare_light(scene.truth.lights[light]), truth.relit[light], truth.object))
    return found
