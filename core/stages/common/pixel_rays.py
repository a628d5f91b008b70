# SPDX-License-Identifier: GPL-3.0-or-later
"""Rays per pixel of all fits to images, decided by how small the surfels are beside the pixels."""

from __future__ import annotations

from dataclasses import replace

from ...progress.protocol import Progress
from ...scene.dataset import Dataset
from ...settings.schema import Settings
from .skip_rules import decide_skip_rule

MIN_SURFELS_PER_PIXEL = 1.5  # surfels per pixel of the object, from which several rays per pixel pay: at 1.4 they no longer do


def with_needed_rays(settings: Settings, dataset: Dataset, progress: Progress) -> Settings:
    """Return settings with one ray per pixel where surfels are larger than pixels: the skip rule "subpixels".

    Several rays per pixel render surfels that are smaller than it, and smooth outlines. A step takes up to twice as long. Where
    surfels were larger than pixels, one ray reproduced held-back photographs as well or better.

    Args:
        settings: settings of the job.
        dataset: training views.
        progress: receives the decision.
    """
    if settings.first.subpixels == 1:
        return settings
    density = settings.first.gaussians / max(1.0, dataset.object_pixels)
    evidence = f"{density:.2g} surfels per pixel of the object"
    if not decide_skip_rule(settings.skip, "subpixels", density < MIN_SURFELS_PER_PIXEL, evidence, progress):
        return settings
    return replace(settings, first=replace(settings.first, subpixels=1))
