# SPDX-License-Identifier: GPL-3.0-or-later
"""Edge selection: normals at edges may disagree with the depth where a trial fit shows that the photographs are then predicted better."""

from __future__ import annotations

from dataclasses import replace

from ...progress.protocol import Progress
from ...scene.dataset import Dataset
from ...settings.schema import FirstStageSettings, Settings
from .material_class import METAL, MaterialClass
from .start_selection import Start
from .trial_fits import MIN_HOLD_BACK_VIEWS, prepare_finer_trial, run_trials

OPEN_EDGES = 0.6  # first part of the schedule in which edges are open, where they are
# dB by which held-back views must be predicted better with open edges. They gain 1.1 on a pine cone and .3 on a machine part in a corner,
# both better in the end; from +.1 to -.1 on five objects that gain nothing or lose.
MARGIN = 0.2
OPEN, CLOSED = "open", "closed"  # names of the trial fits


def select_open_edges(
    dataset: Dataset, settings: Settings, start: Start, material_class: MaterialClass, progress: Progress, crop: bool = False
) -> FirstStageSettings:
    """Select whether edges are open in the first part of the schedule, see `loss_weights`.

    Two trial fits from the start compare both on held-back views. `first.open_edges` decides without them where it is a number.

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
    parts = {CLOSED: 0.0, OPEN: OPEN_EDGES}
    tried = {name: replace(settings, first=replace(first, open_edges=part)) for name, part in parts.items()}
    fits = {name: prepare_finer_trial(dataset, one, start.gaussians, material_class, crop) for name, one in tried.items()}
    progress.phase("edges", first.trial_iterations)
    score, _ = run_trials(fits, settings, progress)
    best = OPEN if score[OPEN] > score[CLOSED] + MARGIN else CLOSED
    progress.decided("open_edges", best == OPEN, "held-back views: " + ", ".join(f"{name} {value:.2f} dB" for name, value in score.items()))
    return tried[best].first


def _reason_against(dataset: Dataset, settings: Settings, material_class: MaterialClass) -> str:
    """Return the reason why no trial is needed, empty where one is."""
    if settings.first.open_edges is not None:
        return "as set"
    if not dataset.has_alpha:
        return "closed: without masks the surroundings' edges would decide"
    if material_class == METAL:
        return "closed: open edges roughen a metal's reflections"
    if len(dataset.train) < MIN_HOLD_BACK_VIEWS:
        return f"closed: {len(dataset.train)} photographs, too few to hold any back"
    return ""
