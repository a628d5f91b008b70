# SPDX-License-Identifier: GPL-3.0-or-later
"""Start selection: surfels start on dense stereo where the photographs show that it is better than the hull or the sparse points."""

from __future__ import annotations

from dataclasses import dataclass

import torch

from ...progress.protocol import Progress
from ...scene.dataset import Dataset
from ...scene.gaussians import Gaussians
from ...settings.schema import Settings
from .depth_anchors import DepthAnchors
from .material_class import METAL, MaterialClass
from .stereo_initialization import StereoStart, from_stereo
from .trial_fits import MIN_HOLD_BACK_VIEWS, prepare_trial, report_trials, run_trials, with_finer_trials

NOT_BETTER = "in no region does stereo fit the photographs better than the visual hull and differ from it by more than a pixel"


@dataclass(frozen=True, eq=False)
class Start:
    """What the first stage starts with.

    Attributes:
        gaussians: initial values.
        anchors: stereo's depths, where the surfels start on stereo's points and masks tell the object from its surroundings.
        metal: (N,) bool, surfels that start as metal; None for none.
    """

    gaussians: Gaussians
    anchors: DepthAnchors | None = None
    metal: torch.Tensor | None = None


def select_start(
    dataset: Dataset, settings: Settings, plain: Gaussians, material_class: MaterialClass, progress: Progress, crop: bool = False
) -> Start:
    """Select the Gaussians that the first stage starts with: on the hull or the sparse points, or on the points of dense stereo.

    Trial fits compare the starts on held-back views (`from_stereo`): with masks, stereo's points by regions with all of them; without
    masks, the sparse points with stereo's, which must be better by `first.stereo_margin` dB. A metal keeps the plain start, since stereo
    sees the depth of its reflections.

    Args:
        dataset: views.
        settings: settings of the job; `first.stereo` decides without evidence where it is "on" or "off".
        plain: Gaussians on the hull, or on the sparse points and at random.
        material_class: class selected with the plain start.
        progress: receives steps and the decision, and may cancel.
        crop: crop the images of the trial fits to the object.

    Raises:
        Cancelled: the user stopped the work.
    """
    choice, name = settings.first.stereo, "the visual hull" if dataset.has_alpha else "sparse points"
    reason = _reason_against(dataset, settings, material_class)
    if reason and choice != "on":
        progress.decided("stereo", False, f"started on {name}: {reason}")
        return Start(plain)
    found = from_stereo(dataset, settings.first.gaussians, settings.seed, progress, everywhere=choice == "on")
    if not found:
        why = "stereo found too few points that views agree on" if found is None else NOT_BETTER
        progress.decided("stereo", False, f"started on {name}: {why}")
        return Start(plain)
    starts = {one.name: one for one in found}
    score: dict[str, float] = {}
    if choice != "on" and (len(starts) > 1 or not dataset.has_alpha):
        tried = {one.name: one.gaussians.to(plain.position.device) for one in found}
        score = _trial(dataset, settings, tried if dataset.has_alpha else {name: plain} | tried, material_class, progress, crop)
    best = starts[max(starts, key=lambda key: score.get(key, 0.0))]
    on = name not in score or score[best.name] > score[name] + settings.first.stereo_margin
    progress.decided("stereo", on, "as set" if choice == "on" else _in_words(best, score))
    if not on:
        return Start(plain)
    anchored = dataset.has_alpha and settings.first.anchor_weight > 0
    return Start(best.gaussians.to(plain.position.device), DepthAnchors.of_maps(best.maps) if anchored else None)


def _in_words(start: StereoStart, score: dict[str, float]) -> str:
    """Return the evidence for a start: the part of its surfels on stereo's points, and the trial fits' PSNR in dB, if there were any."""
    trials = "; held-back views: " + ", ".join(f"{name} {value:.2f} dB" for name, value in score.items()) if score else ""
    return f"{start.share:.1%} of the surfels of {start.name} lie on its points{trials}"


def _trial(
    dataset: Dataset, settings: Settings, starts: dict[str, Gaussians], material_class: MaterialClass, progress: Progress, crop: bool
) -> dict[str, float]:
    """Return the PSNR in dB of a trial fit from each start on held-back views."""
    sized = with_finer_trials(settings) if dataset.has_alpha else settings
    fits = {key: prepare_trial(dataset, sized, start, material_class, crop) for key, start in starts.items()}
    progress.phase("start", settings.first.trial_iterations)
    score, given_up = run_trials(fits, settings, progress)
    if given_up or not dataset.has_alpha:  # with masks, the trial fits of the classes have been reported
        report_trials(settings, given_up, progress)
    return score


def _reason_against(dataset: Dataset, settings: Settings, material_class: MaterialClass) -> str:
    """Return the reason why stereo is not tried, empty where there is none."""
    if settings.first.stereo == "off":
        return "as set"
    if material_class == METAL:
        return "a metal's reflections mislead stereo"
    if len(dataset.train) < MIN_HOLD_BACK_VIEWS:
        return f"{len(dataset.train)} photographs, too few to hold any back"
    return ""
