# SPDX-License-Identifier: GPL-3.0-or-later
"""Edge selection: normals at edges may disagree with the depth where trial fits then predict the photographs better."""

from __future__ import annotations

from dataclasses import replace

from ...progress.protocol import Progress
from .material_class import METAL
from .start import Start
from .start_trials import StartTrials
from .trial_fits import MIN_HOLD_BACK_VIEWS, NO_TRIALS, prepare_trial, report_trials, run_trials, with_finer_trials

OPEN_EDGES = 0.6  # first part of the schedule in which edges are open, where they are
# Lengths of these trial fits and of their schedule, in lengths of a trial: they end where open edges are still open. Of ten
# objects, those on which the fits differ by more than their noise of .2 dB, up to 1.1 dB, decide alike after .6 and after 1.
TRIAL_LENGTH, SCHEDULE_LENGTH = 0.6, 2.0
OPEN, CLOSED = "open", "closed"  # names of the trial fits


def select_open_edges(start: Start, trials: StartTrials, progress: Progress) -> float:
    """Select the first part of the schedule, 0..1, in which edges are open, see `loss_weights`.

    Two trial fits from the start compare open and closed edges on held-back views. Open edges are better there by up to 1.1 dB on objects
    with hollows and corners, which gain in the end, and worse by .05 to .2 on three with parts of metal, whose reflections they roughen.
    Where `first.open_edges` is a number, it decides without trials.

    Args:
        start: what the first stage starts with.
        trials: trial fits of the object.
        progress: receives steps and the decision, and may cancel.

    Raises:
        Cancelled: the user stopped the work.
    """
    settings = trials.settings
    reason = _reason_against(trials)
    if reason:
        part = settings.first.open_edges or 0.0
        progress.decided("open_edges", part > 0, reason)
        return part
    finer = with_finer_trials(settings)
    parts, length = {CLOSED: 0.0, OPEN: OPEN_EDGES}, settings.first.trial_iterations
    longer = replace(finer.first, trial_iterations=max(1, round(SCHEDULE_LENGTH * length)))
    tried = {name: replace(finer, first=replace(longer, open_edges=part)) for name, part in parts.items()}
    of_object = (trials.material_class, trials.crop, start.metal)
    fits = {name: prepare_trial(trials.dataset, one, start.gaussians, *of_object) for name, one in tried.items()}
    shorter = replace(settings, first=replace(settings.first, trial_iterations=max(1, round(TRIAL_LENGTH * length))))
    progress.phase("edges", shorter.first.trial_iterations)
    score, given_up = run_trials(fits, shorter, progress)
    if given_up:
        report_trials(settings, given_up, progress)
    best = max(score, key=lambda name: score[name])
    progress.decided("open_edges", best == OPEN, "held-back views: " + ", ".join(f"{name} {value:.2f} dB" for name, value in score.items()))
    return parts[best]


def _reason_against(trials: StartTrials) -> str:
    """Return the reason why no trial is needed, empty where one is."""
    views = trials.dataset.train
    if trials.settings.first.open_edges is not None:
        return "as set"
    if not trials.dataset.has_alpha:
        return "closed: not tried without masks"
    if trials.material_class == METAL:
        return "closed: open edges roughen a metal's reflections"
    if not trials.settings.first.start_trials:
        return f"closed: {NO_TRIALS}"
    if len(views) < MIN_HOLD_BACK_VIEWS:
        return f"closed: {len(views)} photographs, too few to hold any back"
    return ""
