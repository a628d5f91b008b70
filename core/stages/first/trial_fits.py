# SPDX-License-Identifier: GPL-3.0-or-later
"""Trial fits: brief fits of few surfels to small images, compared on views that are held back from them."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace
from functools import partial

import torch

from ...errors import Cancelled
from ...progress.protocol import Progress
from ...scene.dataset import Dataset
from ...scene.gaussians import Gaussians
from ...settings.schema import Settings
from ..common.preview import points_shape
from ..common.skip_rules import decide_skip_rule
from .material_class import GLOSSY, MaterialClass, with_geometry_rates
from .trainer import Trainer

MIN_HOLD_BACK_VIEWS = 8  # views; with fewer, all are needed for training
NO_TRIALS = "no trial fits of the start, as set"
TRIAL_HOLD_BACK = 6  # every 6th view is held back from a trial fit
# Starts and edges differ in less than material classes do, so that their trial fits are finer. On suzanne_mixed a start on all of stereo's
# points is worse in the end, by .7 dB on new views. Held-back views of finer fits say so by .1 dB; with 8,000 surfels on 100 pixels, or
# after 120 steps, they would prefer all points by .1 dB.
FINER_SURFELS, FINER_RESOLUTION = 2.5, 2  # factors of `first.trial_gaussians` and `first.trial_resolution`
LIGHT_HEIGHT = 32  # rows of the light map; the small images of a trial fit resolve no more
GIVE_UP_LIMITS = ((0.3, 4.0), (0.6, 2.0))  # (fraction of a trial fit done, dB behind the best from which a fit is abandoned)


def prepare_trial(
    dataset: Dataset,
    settings: Settings,
    gaussians: Gaussians,
    material_class: MaterialClass,
    crop: bool,
    metal: torch.Tensor | None = None,
) -> Trainer:
    """Prepare a trial fit: a trainer of few surfels on small images, with one ray per pixel.

    Four rays take 1.3 times as long for the class and twice as long for the start, and decided alike on twelve and seven objects.

    Args:
        dataset: views.
        settings: settings of the job; `first.trial_*` are the fit's size.
        gaussians: initial Gaussians, of which some are selected.
        material_class: initial materials and learning rates; the geometry rates are those of GLOSSY for all, so that the fits differ in
            what is tried alone.
        crop: crop the images to the object.
        metal: (N,) bool, surfels that start as metal; None for none.
    """
    brief, camera = settings.first, dataset.train[0].camera
    few = subsample(gaussians, brief.trial_gaussians, settings.seed)
    if metal is not None:
        metal = metal[chosen_surfels(gaussians.count, brief.trial_gaussians, settings.seed)]
    light_height = min(LIGHT_HEIGHT, brief.light_height)
    size = {"iterations": brief.trial_iterations, "gaussians": few.count, "light_height": light_height}
    brief = replace(brief, **size, single_rays=1.0, inter_reflections=1.0)
    reduction = max(1, max(camera.width, camera.height) // brief.trial_resolution)
    rated = with_geometry_rates(material_class, GLOSSY)
    return Trainer(dataset, brief, few, rated, settings.seed, TRIAL_HOLD_BACK, reduction=reduction, crop=crop, metal=metal)


def with_finer_trials(settings: Settings) -> Settings:
    """Return settings whose trial fits have more surfels and larger images."""
    first = settings.first
    surfels, resolution = int(FINER_SURFELS * first.trial_gaussians), FINER_RESOLUTION * first.trial_resolution
    return replace(settings, first=replace(first, trial_gaussians=surfels, trial_resolution=resolution))


def run_trials(fits: Mapping[str, Trainer], settings: Settings, progress: Progress) -> tuple[dict[str, float], list[str]]:
    """Run all trial fits in turns, to as many steps as `first.trial_iterations`.

    Args:
        fits: by the name of what is tried; those that have been run are only compared.
        settings: settings of the job; the skip rule "trials" lets fits that have fallen behind be abandoned.
        progress: receives steps and previews, and may cancel.

    Returns:
        By name, the PSNR in dB on the held-back views at the end of each fit, or where it was abandoned; and which fits were abandoned,
        in words.

    Raises:
        Cancelled: the user stopped the work.
    """
    iterations = settings.first.trial_iterations
    may_give_up = settings.skip.trials != "off"
    checks = {max(1, int(fraction * iterations)): behind for fraction, behind in GIVE_UP_LIMITS} if may_give_up else {}
    score, running, given_up = dict.fromkeys(fits, 0.0), list(fits), []
    for done in range(1, iterations + 1):
        if progress.cancelled:
            raise Cancelled("stopped during the trial fits")
        for name in running:
            if fits[name].done < done:
                fits[name].step()
        progress.step(done)
        shown = fits[running[0]]
        progress.image(shown.image)
        progress.shape(partial(points_shape, shown.optimizer.gaussians, shown.dataset))
        if done in checks or done == iterations:
            score |= {name: fits[name].test() or 0.0 for name in running}
            limit = max(score.values()) - checks.get(done, math.inf)
            hopeless = [name for name in running if score[name] < limit]
            given_up += [f"{name} after {done} of {iterations} steps" for name in hopeless]
            running = [name for name in running if name not in hopeless]
        if len(running) == 1 and len(fits) > 1:
            break
    return score, given_up


def report_trials(settings: Settings, given_up: list[str], progress: Progress) -> None:
    """Report which trial fits were abandoned, as the skip rule "trials".

    Args:
        settings: settings of the job.
        given_up: trial fits that were abandoned, in words.
        progress: receives the decision.
    """
    decide_skip_rule(settings.skip, "trials", bool(given_up), f"given up: {', '.join(given_up) or 'none'}", progress)


def subsample(gaussians: Gaussians, count: int, seed: int) -> Gaussians:
    """Select surfels at random and enlarge them so that they cover the same area.

    Args:
        gaussians: the surfels.
        count: most surfels to keep.
        seed: seed of the random selection.
    """
    few = gaussians.select(chosen_surfels(gaussians.count, count, seed))
    few.log_scale += 0.5 * math.log(gaussians.count / few.count)
    return few


def chosen_surfels(total: int, count: int, seed: int) -> torch.Tensor:
    """Return the indices, ascending, of the surfels that `subsample` selects.

    Args:
        total: number of surfels to select from.
        count: most surfels to keep.
        seed: seed of the random selection.
    """
    return torch.randperm(total, generator=torch.Generator().manual_seed(seed))[:count].sort().values
