# SPDX-License-Identifier: GPL-3.0-or-later
"""Start selection: surfels start on dense stereo where the photographs show that it is better than the hull or the sparse points."""

from __future__ import annotations

import torch

from ...progress.protocol import Progress
from ...scene.dataset import Dataset
from ...scene.gaussians import Gaussians
from ...settings.schema import Settings
from .depth_anchors import DepthAnchors
from .material_class import METAL, MaterialClass
from .start import Start
from .start_trials import StartTrials
from .stereo_initialization import from_stereo
from .stereo_start import StereoStart
from .trial_fits import MIN_HOLD_BACK_VIEWS
from .vessel import MIN_RELATIVE_DEPTH, MIN_TELLING_DEPTH

# PSNR in dB on held-back views by which a trial fit with open gaps, or as a vessel, must be better: more than noise. With open gaps, a
# pine cone gains .8, a watering can and a plain cup .5; a box with stones .14, a toy car .1, suzanne_mixed and rocker_corner nothing. As
# vessels, a mug gains 2.3, a watering can 1.2, a cardboard box and a glossy bowl .4; a bowl in lacquer nothing. Without a lid, which is
# not tried (`masked_starts.MIN_LID_SHARE`), a plain cup gains nothing, a crate and a part in a corner lose .2, a pot with leaves 1.0, a
# shelf 2.2.
HOLLOW_MARGIN = 0.2
# dB by which an object must fit better as glossy than as low-gloss so that, without trials of starts, only regions start on stereo's
# points: stereo matches reflections. Relit images of drafts by regions, and on all points: a gamepad of black gloss (2.0 dB) 32.2, 29.9 dB,
# the built-in glossy scene (1.8) 23.3, 20.0 dB, a glazed vase (.85) 32.7, 30.2 dB. Nine others fit better as glossy by .46 dB at most.
CLEAR_GLOSS = 0.65
NOT_BETTER = "in no region does stereo fit the photographs better than the visual hull and differ from it by more than a pixel"


def select_start(plain: Gaussians, trials: StartTrials, progress: Progress) -> Start:
    """Select the Gaussians that the first stage starts with: on the hull or the sparse points, or on the points of dense stereo.

    Trial fits compare the starts on held-back views (`from_stereo`): with masks, stereo's points by regions with all of them; without
    masks, the sparse points with stereo's, which must be better by `first.stereo_margin` dB. With masks, the better one is then compared
    with itself with open gaps and as a vessel. With `first.start_trials` off, all of stereo's points are taken, those of regions where the
    object is clearly glossy, with closed gaps, or as a vessel where stereo's depths tell it without a trial. A metal keeps the plain
    start, since stereo sees the depth of its reflections.

    Args:
        plain: Gaussians on the hull, or on the sparse points and at random.
        trials: trial fits of the object, whose class was selected with the plain start; `first.stereo` of its settings decides without
            evidence where it is "on" or "off".
        progress: receives steps and the decision, and may cancel.

    Raises:
        Cancelled: the user stopped the work.
    """
    dataset, settings, hull = trials.dataset, trials.settings, Start(plain)
    choice, name = settings.first.stereo, "the visual hull" if dataset.has_alpha else "sparse points"
    reason = _reason_against(dataset, settings, trials.material_class)
    if reason and choice != "on":
        progress.decided("stereo", False, f"started on {name}: {reason}")
        return hull
    found = from_stereo(dataset, settings.first.gaussians, settings.seed, progress, everywhere=choice == "on")
    if not found:
        why = "stereo found too few points that views agree on" if found is None else NOT_BETTER
        progress.decided("stereo", False, f"started on {name}: {why}")
        return hull
    starts = {one.name: _start(one, trials, plain.position.device) for one in found}
    score: dict[str, float] = {}
    tried = choice != "on" and (settings.first.start_trials or not dataset.has_alpha)
    if tried and (len(starts) > 1 or not dataset.has_alpha):
        progress.phase("start", settings.first.trial_iterations)
        score = trials.compare(starts if dataset.has_alpha else {name: hull} | starts, progress, may_give_up=True)
    untried = found[0] if trials.gloss_gain >= CLEAR_GLOSS else found[-1]
    best = max(found, key=lambda one: score[one.name]) if score else untried
    if tried:
        best = _hollow_where_better(best, starts, score, trials, progress)
    elif choice != "on":
        best = _vessel_where_told(best, starts, trials)
    on = name not in score or score[best.name] > score[name] + settings.first.stereo_margin
    progress.decided("stereo", on, "as set" if choice == "on" else _in_words(best, score))
    return starts[best.name] if on else hull


def _hollow_where_better(
    best: StereoStart, starts: dict[str, Start], score: dict[str, float], trials: StartTrials, progress: Progress
) -> StereoStart:
    """Return a start with its gaps open or as a vessel, where a trial fit from it predicts held-back views better; otherwise the start.

    Args:
        best: the start.
        starts: starts by name; those tried are added.
        score: PSNR of their trial fits in dB, by name; those of these are added.
        trials: trial fits of the object.
        progress: receives steps, and may cancel.
    """
    opened = best.opened() if best.opened is not None else None
    vessel = best.vessel(MIN_RELATIVE_DEPTH) if best.vessel is not None else None
    hollow = [made for made in (opened, vessel) if made is not None]
    if not hollow:
        return best
    device = starts[best.name].gaussians.position.device
    starts |= {one.name: _start(one, trials, device) for one in hollow}
    progress.phase("gaps", trials.settings.first.trial_iterations)
    score |= trials.compare({one.name: starts[one.name] for one in (best, *hollow)}, progress, may_give_up=True)
    better = max(hollow, key=lambda one: score[one.name])
    return better if score[better.name] > score[best.name] + HOLLOW_MARGIN else best


def _vessel_where_told(best: StereoStart, starts: dict[str, Start], trials: StartTrials) -> StereoStart:
    """Return a start as a vessel, where stereo's depths behind the mouth tell it without a trial fit; otherwise the start.

    Args:
        best: the start.
        starts: starts by name; the vessel is added.
        trials: trial fits of the object.
    """
    vessel = best.vessel(MIN_TELLING_DEPTH) if best.vessel is not None else None
    if vessel is None:
        return best
    starts[vessel.name] = _start(vessel, trials, starts[best.name].gaussians.position.device)
    return vessel


def _start(found: StereoStart, trials: StartTrials, device: torch.device) -> Start:
    """Return a start on stereo's points; its depths hold the surfels where masks tell the object from its surroundings."""
    anchored = trials.dataset.has_alpha and trials.settings.first.anchor_weight > 0
    return Start(found.gaussians.to(device), DepthAnchors.of_maps(found.maps) if anchored else None)


def _in_words(start: StereoStart, score: dict[str, float]) -> str:
    """Return the evidence for a start: the part of its surfels on stereo's points, and the trial fits' PSNR in dB, if there were any."""
    trials = "; held-back views: " + ", ".join(f"{name} {value:.2f} dB" for name, value in score.items()) if score else ""
    return f"{start.share:.1%} of the surfels of {start.name} lie on its points{trials}"


def _reason_against(dataset: Dataset, settings: Settings, material_class: MaterialClass) -> str:
    """Return the reason why stereo is not tried, empty where there is none."""
    if settings.first.stereo == "off":
        return "as set"
    if material_class == METAL:
        return "a metal's reflections mislead stereo"
    if len(dataset.train) < MIN_HOLD_BACK_VIEWS:
        return f"{len(dataset.train)} photographs, too few to hold any back"
    return ""
