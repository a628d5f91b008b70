# SPDX-License-Identifier: GPL-3.0-or-later
"""Recovered and true light map of a run: metrics, and pictures of both, their difference, and what the photographs constrain."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ..datasets.format_detection import parse_dataset
from ..datasets.formats.captured import SURROUNDINGS
from ..io.run_files import CAPTURE
from ..io.srgb import encode_srgb
from ..run_folder import read_run
from ..scene.camera_files import load_run_cameras
from ..scene.reconstruction import Reconstruction
from ..scene.surroundings import Surroundings
from ..settings.schema import DataSettings
from . import metrics, visualisation
from .light_confidence import light_confidence
from .light_dependence import CONSTRAINED, constrained_part, light_dependence, on_texels, sphere_mean

# Files without their suffix.
PICTURES = ("light_recovered", "light_true", "light_difference", "light_constrained", "light_dependence", "light_confidence")
MEAN_SHOWN = 0.25  # linear value that the mean light is shown with: skies and rooms keep their detail, and lamps are white
LIMIT = 0.5  # difference of encoded values in the lightest colours
DEPENDENCE_LIMIT = 2.0  # dependence over its mean in the lightest colour


@dataclass(frozen=True, eq=False)
class LightComparison:
    """Recovered light next to the true one, where that is known, on one grid of lat-long texels: row 0 is +Z, the middle column +X.

    Attributes:
        recovered: (H, W, 3) linear, times the scale that the metrics fit where the true light is known.
        true: (H, W, 3) linear; None where it is not known.
        dependence: (H, W) of the photographs on the light, over its mean, see `light_dependence`.
        part: (H, W) bool, directions that the photographs constrain.
        confidence: (H, W) of the recovered light, 0..1, see `light_confidence`.
        figures: metrics by their names in the report.
        description: of that part, one line.
    """

    recovered: np.ndarray
    true: np.ndarray | None
    dependence: np.ndarray
    part: np.ndarray
    confidence: np.ndarray
    figures: dict[str, float]
    description: str

    def pictures(self) -> dict[str, tuple[str, np.ndarray]]:
        """Return caption and image (H, W, 4) of each picture, by one of PICTURES; the maps are shown with one exposure."""
        exposure = MEAN_SHOWN / max(sphere_mean((self.recovered if self.true is None else self.true).mean(-1)), 1e-12)
        recovered, opaque = encode_srgb(self.recovered * exposure), np.ones(self.part.shape)
        shown = visualisation.with_alpha(recovered, opaque)
        pictures = {"light_recovered": ("recovered light", shown)}
        if self.true is not None:
            true = encode_srgb(self.true * exposure)  # not clipped: the difference shows by how much a lamp is too weak
            pictures["light_true"] = "true light", visualisation.with_alpha(true, opaque)
            difference = visualisation.signed_heat((recovered - true).mean(-1), LIMIT)
            pictures["light_difference"] = f"orange: too bright, blue: too dark, to {LIMIT}", difference
        constrained = f"what the photographs constrain: {sphere_mean(self.part):.0%} of the sphere"
        pictures["light_constrained"] = constrained, visualisation.striped(shown, self.part)
        dependence = visualisation.heat(self.dependence, DEPENDENCE_LIMIT)
        pictures["light_dependence"] = f"how much the photographs depend on it, to {DEPENDENCE_LIMIT:g} x the mean", dependence
        pictures["light_confidence"] = "confidence: white where the light is sure", visualisation.grey(self.confidence, opaque)
        return pictures

    @property
    def error(self) -> np.ndarray | None:
        """(H, W) mean difference of the channels, encoded and clipped as in the metrics; None where the true light is not known."""
        if self.true is None:
            return None
        recovered, true = (encode_srgb(np.clip(light, 0, 1)) for light in (self.recovered, self.true))
        return np.abs(recovered - true).mean(-1)


def compare_lights(
    run: Path, reconstruction: Reconstruction, truth: np.ndarray | None, grid: tuple[int, int] | None = None
) -> LightComparison:
    """Compare the light of a run with the true one.

    Args:
        run: folder of the finished run, whose cameras are read.
        reconstruction: of the run.
        truth: (H, W, 3) linear lat-long map in the world of the run; None where it is not known.
        grid: rows and columns of the comparison; those of the true map where it is None, or of the recovered one where that is not known.

    Raises:
        InputError: when the run has no cameras.
    """
    light = reconstruction.environment_map()
    height, width = grid or (light if truth is None else truth).shape[:2]
    photographs = [placed for placed in load_run_cameras(run / "cameras.json") if placed.split == "train"]
    around = _surroundings(run, reconstruction)
    coarse = light_dependence(reconstruction, photographs, around)
    part = constrained_part(coarse, height, width)
    figures = {} if truth is None else metrics.environment_metrics(light, truth, grid, part)
    recovered = metrics.on_grid(light, height, width)
    true = None if truth is None else metrics.on_grid(truth, height, width)
    recovered = recovered if true is None else recovered * metrics.light_scale(recovered, true)
    figures["environment_constrained"] = sphere_mean(part)
    hidden = "the object hides" if around is None else "the object and the surfaces around it hide"
    description = (
        "Constrained part of the light: directions on which the pixels of the photographs depend at least "
        f"{CONSTRAINED:g} times as much as on the mean direction, by the run's surface and materials, without what {hidden}."
    )
    dependence, confidence = on_texels(coarse, height, width), light_confidence(recovered, part)
    return LightComparison(recovered, true, dependence, part, confidence, figures, description)


def _surroundings(run: Path, reconstruction: Reconstruction) -> Surroundings | None:
    """Return the surfaces around the object that its capture found, in the world of the run; None where none are on the disk."""
    for folder in (run / CAPTURE, Path(read_run(run)["dataset"])):
        if (folder / SURROUNDINGS).is_file():
            parsed = parse_dataset(folder, DataSettings())
            to_run = reconstruction.to_world @ np.linalg.inv(parsed.to_world)
            return None if parsed.surroundings is None else parsed.surroundings.moved(to_run)
    return None
