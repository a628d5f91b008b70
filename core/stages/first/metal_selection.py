# SPDX-License-Identifier: GPL-3.0-or-later
"""Metal selection: regions of the start that begin as metal, where trial fits then predict the photographs better."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import torch

from ...progress.protocol import Progress
from ...scene.camera import Camera
from ...scene.dataset import Dataset
from ...settings.schema import Settings
from .layered_regions import layered_regions
from .material_class import METAL, MaterialClass
from .start_selection import Start
from .trainer import Trainer
from .trial_fits import MIN_HOLD_BACK_VIEWS, prepare_trial, run_trials, with_finer_trials

# A region's squared error without metal over that with it, on held-back views, from which it begins as metal: 1 dB. On ten
# objects, ears, a shackle and arm rings of metal gain 1.1 to 2.7 dB; a belt and a ball that stereo sees too deep (see
# `select_spheres`) do not, and some 40 regions of other materials gain at most 0.9 dB.
MIN_ERROR_RATIO = 1.25
VISIBLE = 0.03  # radii of the bound by which a region's points may lie behind the rendered depth and still count as seen
MIN_OPACITY = 0.5  # opacity from which a pixel has a depth
MIN_PIXELS = 30  # of held-back views that must show a region


def select_metal(
    dataset: Dataset, settings: Settings, start: Start, material_class: MaterialClass, progress: Progress, crop: bool = False
) -> Start:
    """Select the regions of the start that begin as metal.

    All surfels of a glossy object start with hardly any metallic, and the optimisation does not raise it enough: in parts of metal they
    follow the virtual images. Candidates are the regions whose points lie in several layers. One trial fit has all of them as metal,
    another has none; each region is compared where held-back views show it.

    Args:
        dataset: views.
        settings: settings of the job; `first.metal_regions` decides without evidence where it is "on" or "off".
        start: what the first stage starts with.
        material_class: class of the object.
        progress: receives steps and the decision, and may cancel.
        crop: crop the images of the trial fits to the object.

    Returns:
        The start with its metal.

    Raises:
        Cancelled: the user stopped the work.
    """
    reason = reason_against_metal(dataset, settings, material_class)
    if reason:
        progress.decided("metal_regions", False, reason)
        return start
    points = start.gaussians.position.T.double().cpu().numpy()
    regions = layered_regions(points, start.gaussians.normals().T.double().cpu().numpy(), dataset.bound.radius)
    found = f"{len(regions)} regions whose points lie in several layers"
    if settings.first.metal_regions == "on":
        chosen, evidence = regions, f"{found}, as set"
    elif regions:
        gains = _trial(dataset, settings, start, material_class, points, regions, progress, crop)
        chosen = [region for region, gain in zip(regions, gains, strict=True) if gain > MIN_ERROR_RATIO]
        evidence = f"{len(chosen)} of {found}; held-back views: {', '.join(f'{10 * math.log10(gain):+.1f} dB' for gain in gains)}"
    else:
        chosen, evidence = [], "nowhere do the start's points lie in several layers"
    progress.decided("metal_regions", bool(chosen), evidence)
    if not chosen:
        return start
    return replace(start, metal=torch.from_numpy(np.any(chosen, 0)).to(start.gaussians.position.device))


def _trial(
    dataset: Dataset,
    settings: Settings,
    start: Start,
    material_class: MaterialClass,
    points: np.ndarray,
    regions: list[np.ndarray],
    progress: Progress,
    crop: bool,
) -> list[float]:
    """Return the error of each region without metal over that with it on held-back views, by two trial fits; 1 where they hardly show it.

    Args:
        dataset: views.
        settings: settings of the job.
        start: what the first stage starts with.
        material_class: class of the object.
        points: (N, 3) centres of the start's surfels.
        regions: masks (N,) bool, at least one.
        progress: receives steps, and may cancel.
        crop: crop the images to the object.
    """
    metal = torch.from_numpy(np.any(regions, 0)).to(start.gaussians.position.device)
    # Both fits go on to the end, however far one is behind elsewhere.
    finer = with_finer_trials(settings)
    both = replace(finer, first=replace(finer.first, open_edges=0.0), skip=replace(finer.skip, trials="off"))
    without = prepare_trial(dataset, both, start.gaussians, material_class, crop)
    with_metal = prepare_trial(dataset, both, start.gaussians, material_class, crop, metal)
    progress.phase("metal", settings.first.trial_iterations)
    run_trials({"as its class": without, "as metal": with_metal}, both, progress)
    pairs = zip(region_errors(without, without, points, regions), region_errors(with_metal, without, points, regions), strict=True)
    return [float(one / other) if min(one, other) > 0 else 1.0 for one, other in pairs]


def region_errors(fit: Trainer, shape: Trainer, points: np.ndarray, regions: list[np.ndarray]) -> np.ndarray:
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


def reason_against_metal(dataset: Dataset, settings: Settings, material_class: MaterialClass) -> str:
    """Return the reason why no region is tried as metal, empty where there is none.

    Args:
        dataset: views.
        settings: settings of the job.
        material_class: class of the object.
    """
    if settings.first.metal_regions == "off":
        return "as set"
    if not dataset.has_alpha:
        return "not tried without masks"
    if not material_class.split_sum:
        return "a low-gloss object has no reflections"
    if material_class == METAL:
        return "the whole object begins as metal"
    if len(dataset.train) < MIN_HOLD_BACK_VIEWS:
        return f"{len(dataset.train)} photographs, too few to hold any back"
    return ""
