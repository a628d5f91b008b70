# SPDX-License-Identifier: GPL-3.0-or-later
"""Edge selection: normals at edges may disagree with the depth where trial fits then predict the photographs better."""

from __future__ import annotations

from dataclasses import replace

from ...progress.protocol import Progress
from ...scene.dataset import Dataset
from ...settings.schema import FirstStageSettings, Settings
from .material_class import METAL, MaterialClass
from .start_selection import Start
from .trial_fits import MIN_HOLD_BACK_VIEWS, prepare_trial, report_trials, run_trials, with_finer_trials

OPEN_EDGES = 0.6  # first part of the schedule in which edges are open, where they are
# Length of the trial fits' schedule in lengths of a trial. They end in the middle of it, where open edges are still open.
SCHEDULE_FACTOR = 2
OPEN, CLOSED = "open", "closed"  # names of the trial fits


def select_open_edges(
    dataset: Dataset, settings: Settings, start: Start, material_class: MaterialClass, progress: Progress, crop: bool = False
) -> FirstStageSettings:
    """Select whether edges are open in the first part of the schedule, see `loss_weights`.

    Two trial fits from the start compare both on held-back views. Open edges are better there by up to 1.1 dB on objects with hollows and
    corners, which gain in the end, and worse by .05 to .2 on three with parts of metal, whose reflections they roughen. Where
    `first.open_edges` is a number, it decides without trials.

    Args:
        dataset: views.
        settings: settings of the job.
        start: what the first stage starts with.
        material_class: class of the object.
        progress: receives steps and the decision, and may cancel.
        crop: crop the images of the trial fits to the object.

    Returns:
        The first stage's settings, in which `open_edges` is a number.

    Raises:
        Cancelled: the user stopped the work.
    """
    first = settings.first
    reason = _reason_against(dataset, settings, material_class)
    if reason:
        part = first.open_edges or 0.0
        progress.decided("open_edges", part > 0, reason)
        return replace(first, open_edges=part)
    finer = with_finer_trials(settings)
    longer = replace(finer.first, trial_iterations=SCHEDULE_FACTOR * first.trial_iterations)
    parts = {CLOSED: 0.0, OPEN: OPEN_EDGES}
    tried = {name: replace(finer, first=replace(longer, open_edges=part)) for name, part in parts.items()}
    fits = {name: prepare_trial(dataset, one, start.gaussians, material_class, crop, start.metal) for name, one in tried.items()}
    progress.phase("edges", settings.first.trial_iterations)
    score, given_up = run_trials(fits, settings, progress)
    if given_up:
        report_trials(settings, given_up, progress)
    best = max(score, key=lambda name: score[name])
    progress.decided("open_edges", best == OPEN, "held-back views: " + ", ".join(f"{name} {value:.2f} dB" for name, value in score.items()))
    return replace(first, open_edges=parts[best])


def _reason_against(dataset: Dataset, settings: Settings, material_class: MaterialClass) -> str:
    """Return the reason why no trial is needed, empty where one is."""
    if settings.first.open_edges is not None:
        return "as set"
    if not dataset.has_alpha:
        return "closed: not tried without masks"
    if material_class == METAL:
        return "closed: open edges roughen a metal's reflections"
    if len(dataset.train) < MIN_HOLD_BACK_VIEWS:
        return f"closed: {len(dataset.train)} photographs, too few to hold any back"
    return ""
