# SPDX-License-Identifier: GPL-3.0-or-later
"""Material class selection: brief fits of every allowed material class are compared on held-back views."""

from __future__ import annotations

import math
from dataclasses import replace

import torch

from ...errors import Cancelled
from ...progress.protocol import Progress
from ...scene.dataset import Dataset
from ...scene.gaussians import Gaussians
from ...settings.schema import Settings
from ..common.skip_rules import decide_skip_rule
from .material_class import COATED, MATERIAL_CLASSES, MaterialClass, allowed_material_classes, with_geometry_rates
from .trainer import Trainer, invalid_checkpoint

HOLD_BACK_FROM = 8  # views; with fewer, all are needed for training
BRIEF_FIT_HOLD_BACK = 6  # every 6th view is held back from a brief fit
LIGHT_HEIGHT = 32  # rows of the light map; the small images of a brief fit resolve no more
GIVE_UP = ((0.3, 4.0), (0.6, 2.0))  # (fraction of a brief fit done, dB behind the best from which a fit is abandoned)


def select_material_class(
    dataset: Dataset, settings: Settings, gaussians: Gaussians, progress: Progress, crop: bool = False
) -> MaterialClass:
    """Select the object's material class: fit every allowed class briefly and take the one that predicts held-back views best.

    A class must be better by `first.trial_margin` dB than the less reflecting one selected before it. Where no view can be held back,
    or no mask separates the object from its background, the first of the allowed classes is returned.

    Args:
        dataset: views.
        settings: of the job.
        gaussians: initial Gaussians.
        progress: receives steps and messages, and may cancel.
        crop: crop the images to the object.

    Raises:
        Cancelled: the user stopped the work.
    """
    classes = allowed_material_classes(settings.materials)
    if not dataset.has_alpha:
        progress.message(f"materials: {classes[0].name}; without masks the background would be taken for reflections")
        return material_class_named(classes[0].name, dataset)
    if len(classes) == 1 or len(dataset.train) < HOLD_BACK_FROM:
        return classes[0]
    # The same geometry rates for all: the shading models are compared, not the rates.
    fits = {m: _brief_fit(dataset, settings, gaussians, with_geometry_rates(m, COATED), crop) for m in classes}
    score = _compare(fits, settings, progress)
    best = classes[0]
    for material_class in classes[1:]:
        best = material_class if score[material_class] > score[best] + settings.first.trial_margin else best
    progress.message("materials: " + ", ".join(f"{m.name} {v:.2f} dB" for m, v in score.items()) + f" -> {best.name}")
    return best


def _brief_fit(dataset: Dataset, settings: Settings, gaussians: Gaussians, material_class: MaterialClass, crop: bool) -> Trainer:
    """Return a trainer of few surfels on small images."""
    brief, camera = settings.first, dataset.train[0].camera
    few = subsample(gaussians, brief.trial_gaussians, settings.seed)
    light_height = min(LIGHT_HEIGHT, brief.light_height)
    brief = replace(brief, iterations=brief.trial_iterations, gaussians=few.count, light_height=light_height)
    reduction = max(1, max(camera.width, camera.height) // brief.trial_resolution)
    return Trainer(dataset, brief, few, material_class, settings.seed, BRIEF_FIT_HOLD_BACK, reduction, crop)


def _compare(fits: dict[MaterialClass, Trainer], settings: Settings, progress: Progress) -> dict[MaterialClass, float]:
    """Run all fits in turns and return the PSNR in dB on the held-back views, at the end of each fit or where it was abandoned."""
    iterations = settings.first.trial_iterations
    progress.phase("materials", iterations)
    may_give_up = settings.skip.trials != "off"
    checks = {max(1, int(fraction * iterations)): behind for fraction, behind in GIVE_UP} if may_give_up else {}
    score, running, given_up = dict.fromkeys(fits, 0.0), list(fits), []
    for done in range(1, iterations + 1):
        if progress.cancelled:
            raise Cancelled("stopped during material class selection")
        for material_class in running:
            fits[material_class].step()
        progress.step(done)
        progress.image(fits[running[0]].image)
        if done in checks or done == iterations:
            score |= {m: fits[m].test() or 0.0 for m in running}
            limit = max(score.values()) - checks.get(done, math.inf)
            hopeless = [m for m in running if score[m] < limit]
            given_up += [f"{m.name} after {done} of {iterations} steps" for m in hopeless]
            running = [m for m in running if m not in hopeless]
        if len(running) == 1:
            break
    decide_skip_rule(settings.skip, "trials", bool(given_up), f"given up: {', '.join(given_up) or 'none'}", progress)
    return score


def material_class_named(name: str, dataset: Dataset) -> MaterialClass:
    """Return the material class of a name with the learning rates for a dataset.

    Args:
        name: of the class.
        dataset: without masks, where the first stage starts on sparse points, the higher geometry rates of COATED apply: surfels have
            farther to move than from a visual hull.

    Raises:
        InputError: there is no class of this name.
    """
    material_class = next((m for m in MATERIAL_CLASSES if m.name == name), None)
    if material_class is None:
        raise invalid_checkpoint()
    return material_class if dataset.has_alpha else with_geometry_rates(material_class, COATED)


def subsample(gaussians: Gaussians, count: int, seed: int) -> Gaussians:
    """Select surfels at random and enlarge them so that they cover the same area.

    Args:
        gaussians: the surfels.
        count: most surfels to keep.
        seed: of the selection.
    """
    index = torch.randperm(gaussians.count, generator=torch.Generator().manual_seed(seed))[:count]
    few = gaussians.select(index.sort().values)
    few.log_scale += 0.5 * math.log(gaussians.count / few.count)
    return few
