# SPDX-License-Identifier: GPL-3.0-or-later
"""Tracer of secondary rays for a dataset's photographs."""

from __future__ import annotations

from ...rendering.secondary_rays import SecondaryTracer
from ...rendering.turning_light import mean_over_lights
from ...scene.dataset import Dataset
from ...scene.reconstruction import Reconstruction
from ...settings.schema import SecondStageSettings


def secondary_tracer(reconstruction: Reconstruction, dataset: Dataset, settings: SecondStageSettings) -> SecondaryTracer:
    """Return the tracer of a reconstruction's surfels and of the dataset's surroundings.

    Args:
        reconstruction: surfels with their present normals.
        dataset: photographs, with near surfaces where they were captured.
        settings: settings of the second stage.
    """
    near = dataset.surroundings if settings.surroundings and settings.indirect else None  # shadows without their light would be wrong
    return SecondaryTracer(mean_over_lights(reconstruction, dataset.train), near, settings.shadows)
