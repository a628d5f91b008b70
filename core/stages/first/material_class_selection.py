# SPDX-License-Identifier: GPL-3.0-or-later
"""Material class selection: trial fits of every allowed material class are compared on held-back views."""

from __future__ import annotations

import math
from typing import NamedTuple

from ...progress.protocol import Progress
from ...scene.dataset import Dataset, light_rotations
from ...scene.gaussians import Gaussians
from ...settings.schema import Settings
from .checkpoint_state import invalid_checkpoint
from .material_class import GLOSSY, LOW_GLOSS, MATERIAL_CLASSES, METAL, MaterialClass, allowed_material_classes, with_geometry_rates
from .trial_fits import MIN_HOLD_BACK_VIEWS, prepare_trial, report_trials, run_trials

# dB by which a more reflecting class must be better where the light turns, beside `first.trial_margin`: a reflected light map also explains
# some of the matt shading that changes with the turns (0.7 dB on a dielectric of roughness 0.45), for which SH need more than a brief fit.
TURNING_LIGHT_MARGIN = 1.0
# dB by which metal must be better than low-gloss to be chosen where glossy is about as good: it is by 3.2 to 5.4 on four metal objects. Of
# thirteen others, glossy is as good only on a resin skull under the camera's flash, where metal is better than low-gloss by .6.
MIN_METAL_DECIBELS = 2.0


class SelectedClass(NamedTuple):
    """Material class of an object.

    Attributes:
        material_class: the class.
        gloss_gain: dB by which a trial fit as glossy predicts held-back views better than one as low-gloss, each at its end or where it was
            abandoned; 0 where these were not made.
    """

    material_class: MaterialClass
    gloss_gain: float = 0.0


def select_material_class(
    dataset: Dataset, settings: Settings, gaussians: Gaussians, progress: Progress, crop: bool = False
) -> SelectedClass:
    """Select the object's material class: fit every allowed class briefly and take the one that predicts held-back views best.

    Glossy is the rule: SH that explain all shading fit a brief trial as well, but leave worse normals and materials in the end. So
    low-gloss must be better by `first.trial_margin` dB, and so must metal, unless the object clearly reflects (MIN_METAL_DECIBELS): there
    glossy is free to fit as well with a coat as with metal. Where the light turns, glossy must be better, see TURNING_LIGHT_MARGIN.
    Where no view can be held back, or no mask separates the object from its background, the first of the allowed classes is returned.

    Args:
        dataset: views.
        settings: settings of the job.
        gaussians: initial Gaussians.
        progress: receives steps and messages, and may cancel.
        crop: crop the images to the object.

    Returns:
        The class, and how much better the object fits as glossy.

    Raises:
        Cancelled: the user stopped the work.
    """
    classes = allowed_material_classes(settings.materials)
    if not dataset.has_alpha:
        progress.message(f"materials: {classes[0].name}; without masks the background would be taken for reflections")
        return SelectedClass(material_class_named(classes[0].name, dataset))
    if len(classes) == 1 or len(dataset.train) < MIN_HOLD_BACK_VIEWS:
        return SelectedClass(classes[0])
    fits = {m.name: prepare_trial(dataset, settings, gaussians, m, crop) for m in classes}
    progress.phase("materials", settings.first.trial_iterations)
    score, given_up = run_trials(fits, settings, progress)
    report_trials(settings, given_up, progress)
    turns = light_rotations(dataset.train) is not None
    margins = _margins(settings.first.trial_margin, turns)
    best = _choose(score, margins, turns)
    progress.message(_choice_in_words(score, best, margins))
    gain = score[GLOSSY.name] - score[LOW_GLOSS.name] if {GLOSSY.name, LOW_GLOSS.name} <= score.keys() else 0.0
    return SelectedClass(next(m for m in classes if m.name == best), gain)


def _margins(margin: float, turns: bool) -> dict[str, float]:
    """Return by how many dB a class must be better than a less reflecting one.

    Args:
        margin: the setting `first.trial_margin`.
        turns: the light turns.
    """
    return dict.fromkeys((GLOSSY.name, METAL.name), margin + TURNING_LIGHT_MARGIN) if turns else {GLOSSY.name: -margin, METAL.name: margin}


def _choose(score: dict[str, float], margins: dict[str, float], turns: bool) -> str:
    """Return the name of the class that is better than the less reflecting ones by its margin, or of metal where glossy is about as good.

    Args:
        score: PSNR of each class in dB, the least reflecting first.
        margins: dB by which a class must be better than a less reflecting one.
        turns: the light turns.
    """
    best, *rest = score
    for name in rest:
        best = name if score[name] > score[best] + margins[name] else best
    if best == METAL.name and score[best] <= score.get(GLOSSY.name, -math.inf) + margins[best]:
        best = GLOSSY.name  # it reflects, but need not be metal
    if best == GLOSSY.name and not turns and _clearly_reflects(score, margins[METAL.name]):
        return METAL.name
    return best


def _clearly_reflects(score: dict[str, float], margin: float) -> bool:
    """Return True where metal is at most `margin` dB worse than glossy, and better than low-gloss by more than MIN_METAL_DECIBELS."""
    metal, matt = score.get(METAL.name, -math.inf), score.get(LOW_GLOSS.name, math.inf)
    return metal > score[GLOSSY.name] - margin and metal > matt + MIN_METAL_DECIBELS


def _choice_in_words(score: dict[str, float], chosen: str, margins: dict[str, float]) -> str:
    """Return the choice with its reason, in one line.

    Args:
        score: PSNR of each class in dB, the least reflecting first.
        chosen: name of the class.
        margins: dB by which a class must be better than a less reflecting one.
    """
    best = max(score, key=lambda name: score[name])
    if best != chosen:
        gain, needed = score[best] - score[chosen], abs(margins[max(best, chosen, key=list(score).index)])
        return f"materials: {chosen}; {best} would be only {gain:.1f} dB better, less than the {needed:.1f} dB that it needs"
    rest = [value for name, value in score.items() if name != chosen]
    return f"materials: {chosen}, {score[chosen] - max(rest):.1f} dB better than the next on held-back photographs"


def material_class_named(name: str, dataset: Dataset) -> MaterialClass:
    """Return the material class of a name with the learning rates for a dataset.

    Args:
        name: name of the class.
        dataset: without masks, where the first stage starts on sparse points, the higher geometry rates of GLOSSY apply: surfels have
            farther to move than from a visual hull.

    Raises:
        InputError: there is no class of this name.
    """
    material_class = next((m for m in MATERIAL_CLASSES if m.name == name), None)
    if material_class is None:
        raise invalid_checkpoint()
    return material_class if dataset.has_alpha else with_geometry_rates(material_class, GLOSSY)
