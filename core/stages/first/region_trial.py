# SPDX-License-Identifier: GPL-3.0-or-later
"""Region trial: two starts of the first stage are fitted briefly, and compared region by region on held-back views."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
import torch

from ...progress.protocol import Progress
from ...scene.camera import Camera
from .start import Start
from .start_trials import StartTrials
from .trainer import Trainer

VISIBLE = 0.03  # radii of the bound by which a region's points may lie behind the rendered depth and still count as seen
MIN_OPACITY = 0.5  # opacity from which a pixel has a depth
MIN_PIXELS = 30  # of held-back views that must show a region


def region_gains(
    trials: StartTrials, starts: tuple[Start, Start], shape: int, regions: Sequence[np.ndarray], progress: Progress
) -> list[float]:
    """Return the squared error of each region from the first start over that from the second; NaN where held-back views hardly show it.

    Args:
        trials: trial fits of the object.
        starts: what is compared, with the same number of surfels.
        shape: 0 or 1, the start whose surfels, and whose fit's depth, tell which pixels show a region.
        regions: masks (N,) bool of that start's surfels, at least one.
        progress: receives steps, and may cancel.

    Raises:
        Cancelled: the user stopped the work.
    """
    # Both fits go on to the end, however far one is behind elsewhere.
    trials.compare({"first": starts[0], "second": starts[1]}, progress, may_give_up=False)
    fits = [trials.fit_of(start) for start in starts]
    first, second = (_region_errors(fit, fits[shape], starts[shape].points(), regions) for fit in fits)
    return [float(one / other) if min(one, other) > 0 else math.nan for one, other in zip(first, second, strict=True)]


def gains_in_words(gains: Sequence[float]) -> str:
    """Return `region_gains` in decibels, as evidence for a decision."""
    return "held-back views: " + ", ".join("not seen" if math.isnan(gain) else f"{10 * math.log10(gain):+.1f} dB" for gain in gains)


def _region_errors(fit: Trainer, shape: Trainer, points: np.ndarray, regions: Sequence[np.ndarray]) -> np.ndarray:
    """Return the sum of squared errors (R,) of a trial fit over the pixels of held-back views that show a region; 0 for too few pixels.

    Args:
        fit: trial fit.
        shape: trial fit whose depth tells which points are seen, the same for all that are compared.
        points: (N, 3) of the start, world.
        regions: masks (N,) bool.
    """
    errors, pixels = np.zeros(len(regions)), np.zeros(len(regions), int)
    for index in torch.nonzero(fit.held_back)[:, 0].tolist():
        view = fit.training_views[index].to(fit.device)
        with torch.no_grad():
            error = (fit.render(view)[0].clamp(0, 1) - view.image).square().mean(0).cpu().numpy()
            depth, alpha = shape.render(view)[1][-2:].cpu().numpy()
        limit = np.where(alpha > MIN_OPACITY, depth / np.maximum(alpha, MIN_OPACITY) + VISIBLE * fit.dataset.bound.radius, 0)
        for number, region in enumerate(regions):
            shown = _pixels(points[region], view.camera, limit)
            errors[number] += error[shown].sum()
            pixels[number] += shown.sum()
    return np.where(pixels >= MIN_PIXELS, errors, 0.0)


def _pixels(points: np.ndarray, camera: Camera, limit: np.ndarray) -> np.ndarray:
    """Return the pixels (H, W) bool at which a camera shows some of the points (N, 3): they are nearer than the depth `limit` (H, W)."""
    pixel, distance = camera.project(points)
    inside = camera.in_image(pixel, distance)
    column, row = pixel[inside].astype(int).T
    near, shown = distance[inside] < limit[row, column], np.zeros(limit.shape, bool)
    shown[row[near], column[near]] = True
    return shown
