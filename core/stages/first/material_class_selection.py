# SPDX-License-Identifier: GPL-3.0-or-later
"""What the object is made of, decided by brief fits of each kind that are compared on views held back."""

from __future__ import annotations

import math
from dataclasses import replace

import torch

from ...errors import Cancelled
from ...progress.protocol import Progress
from ...scene.dataset import Dataset
from ...scene.gaussians import Gaussians
from ...settings.schema import Settings
from ..common.skip_rules import decide
from .material_class import COATED, KINDS, MaterialClass, candidates, with_schedule_scale
from .trainer import Trainer, no_state

HOLD_BACK_FROM = 8  # views; fewer are all needed
TRIAL_HOLD_BACK = 6  # one view in so many tests a trial
LIGHT_HEIGHT = 32  # rows; images this small show no more
HOPELESS = ((0.3, 4.0), (0.6, 2.0))  # by this share of a trial, so many dB behind the best is too far to catch up


def select_material_class(
    dataset: Dataset, settings: Settings, gaussians: Gaussians, progress: Progress, cut: bool = False
) -> MaterialClass:
    """Decide what the object is made of: fit every kind briefly and take what explains the held-back views best.

    Each kind must be better by `trial_margin` than the less reflecting one before it. Where no view can be held back, or no mask
    tells the object from its background, it is the first of the allowed kinds. `cut`: images are cut to the object.
    """
    kinds = candidates(settings.materials)
    if not dataset.has_alpha:
        progress.message(f"materials: {kinds[0].name}; without masks the background would pass for reflections")
        return material_class_named(kinds[0].name, dataset)
    if len(kinds) == 1 or len(dataset.train) < HOLD_BACK_FROM:
        return kinds[0]
    # All at one pace: what is compared is the model.
    trials = {kind: _trial(dataset, settings, gaussians, with_schedule_scale(kind, COATED), cut) for kind in kinds}
    score = _compared(trials, settings, progress)
    best = kinds[0]
    for kind in kinds[1:]:
        best = kind if score[kind] > score[best] + settings.first.trial_margin else best
    progress.message("materials: " + ", ".join(f"{k.name} {v:.2f} dB" for k, v in score.items()) + f" -> {best.name}")
    return best


def _trial(dataset: Dataset, settings: Settings, gaussians: Gaussians, kind: MaterialClass, cut: bool) -> Trainer:
    """A fit of few surfels to small images."""
    brief, camera = settings.first, dataset.train[0].camera
    few = thinned_out(gaussians, brief.trial_gaussians, settings.seed)
    light_height = min(LIGHT_HEIGHT, brief.light_height)
    brief = replace(brief, iterations=brief.trial_iterations, gaussians=few.count, light_height=light_height)
    reduction = max(1, max(camera.width, camera.height) // brief.trial_resolution)
    return Trainer(dataset, brief, few, kind, settings.seed, TRIAL_HOLD_BACK, reduction, cut)


def _compared(trials: dict[MaterialClass, Trainer], settings: Settings, progress: Progress) -> dict[MaterialClass, float]:
    """dB of each kind on the held-back views, at its end or where it was given up; all are fitted side by side."""
    iterations = settings.first.trial_iterations
    progress.phase("materials", iterations)
    gives_up = settings.skip.trials != "off"
    marks = {max(1, int(share * iterations)): behind for share, behind in HOPELESS} if gives_up else {}
    score, running, given_up = dict.fromkeys(trials, 0.0), list(trials), []
    for done in range(1, iterations + 1):
        if progress.cancelled:
            raise Cancelled("stopped while the kind of material was being decided")
        for kind in running:
            trials[kind].step()
        progress.step(done)
        progress.image(trials[running[0]].image)
        if done in marks or done == iterations:
            score |= {kind: trials[kind].test() or 0.0 for kind in running}
            limit = max(score.values()) - marks.get(done, math.inf)
            hopeless = [kind for kind in running if score[kind] < limit]
            given_up += [f"{kind.name} after {done} of {iterations} steps" for kind in hopeless]
            running = [kind for kind in running if kind not in hopeless]
        if len(running) == 1:
            break
    decide(settings.skip, "trials", bool(given_up), f"given up: {', '.join(given_up) or 'none'}", progress)
    return score


def material_class_named(name: str, dataset: Dataset) -> MaterialClass:
    """The kind of that name at its pace for this dataset: what starts on sparse points has farther to go than what starts on a hull.

    Raises InputError where there is none.
    """
    kind = next((k for k in KINDS if k.name == name), None)
    if kind is None:
        raise no_state()
    return kind if dataset.has_alpha else with_schedule_scale(kind, COATED)


def thinned_out(gaussians: Gaussians, count: int, seed: int) -> Gaussians:
    """At most `count` of the surfels, larger so that they cover the same surface."""
    index = torch.randperm(gaussians.count, generator=torch.Generator().manual_seed(seed))[:count]
    few = gaussians.select(index.sort().values)
    few.log_scale += 0.5 * math.log(gaussians.count / few.count)
    return few
