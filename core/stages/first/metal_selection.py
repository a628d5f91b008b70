# SPDX-License-Identifier: GPL-3.0-or-later
"""Metal selection: regions of the start that begin as metal, where trial fits then predict the photographs better."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import torch

from ...progress.protocol import Progress
from .material_class import METAL
from .region_trial import gains_in_words, region_gains
from .start import Start
from .start_trials import StartTrials
from .trial_fits import MIN_HOLD_BACK_VIEWS, NO_TRIALS

# A region's squared error without metal over that with it, on held-back views, from which it begins as metal: 1 dB. On ten
# objects, ears, a shackle and arm rings of metal gain 1.1 to 2.7 dB; a belt and a ball that stereo sees too deep (see
# `select_spheres`) do not, and some 40 regions of other materials gain at most 0.9 dB.
MIN_ERROR_RATIO = 1.25
MAX_METAL = 0.5  # fraction of a region's surfels that are metal, from which it is a region of metal


def select_metal(start: Start, trials: StartTrials, progress: Progress) -> Start:
    """Select the regions of the start that begin as metal.

    All surfels of a glossy object start with hardly any metallic, and the optimisation does not raise it enough: in parts of metal they
    follow the virtual images. Candidates are the regions whose points lie in several layers. One trial fit has all of them as metal,
    another has none; each region is compared where held-back views show it.

    Args:
        start: what the first stage starts with.
        trials: trial fits of the object; `first.metal_regions` of its settings decides without evidence where it is "on" or "off".
        progress: receives steps and the decision, and may cancel.

    Returns:
        The start with its metal.

    Raises:
        Cancelled: the user stopped the work.
    """
    reason = reason_against_metal(trials)
    if reason:
        progress.decided("metal_regions", False, reason)
        return start
    regions = trials.layered_regions(start)
    if not regions:
        progress.decided("metal_regions", False, "nowhere do the start's points lie in several layers")
        return start
    found, metal = f"{len(regions)} regions whose points lie in several layers", _as_metal(start, regions)
    if trials.settings.first.metal_regions == "on":
        chosen, evidence = regions, f"{found}, as set"
    else:
        progress.phase("metal", trials.settings.first.trial_iterations)
        gains = region_gains(trials, (start, metal), 0, regions, progress)
        chosen = [region for region, gain in zip(regions, gains, strict=True) if gain > MIN_ERROR_RATIO]
        evidence = f"{len(chosen)} of {found}; {gains_in_words(gains)}"
    progress.decided("metal_regions", bool(chosen), evidence)
    if len(chosen) == len(regions):
        return metal  # its trial fit is made
    return _as_metal(start, chosen) if chosen else start


def _as_metal(start: Start, regions: list[np.ndarray]) -> Start:
    """Return a start with regions, masks (N,) bool, as metal."""
    return replace(start, metal=torch.from_numpy(np.any(regions, 0)).to(start.gaussians.position.device))


def unmetallic_regions(start: Start, trials: StartTrials) -> list[np.ndarray]:
    """Return the masks (N,) bool of the regions whose points lie in several layers and that are not metal yet.

    Args:
        start: with its metal.
        trials: trial fits of the object.
    """
    metal = np.zeros(start.gaussians.count, bool) if start.metal is None else start.metal.cpu().numpy()
    return [region for region in trials.layered_regions(start) if metal[region].mean() < MAX_METAL]


def reason_against_metal(trials: StartTrials, *, by_trials: bool = True) -> str:
    """Return the reason why no region is tried as metal, empty where there is none.

    Args:
        trials: trial fits of the object.
        by_trials: trial fits decide, which the settings may leave out.
    """
    views = trials.dataset.train
    if trials.settings.first.metal_regions == "off":
        return "as set"
    if not trials.dataset.has_alpha:
        return "not tried without masks"
    if by_trials and trials.settings.first.metal_regions == "auto" and not trials.settings.first.start_trials:
        return NO_TRIALS
    if not trials.material_class.split_sum:
        return "a low-gloss object has no reflections"
    if trials.material_class == METAL:
        return "the whole object begins as metal"
    if len(views) < MIN_HOLD_BACK_VIEWS:
        return f"{len(views)} photographs, too few to hold any back"
    return ""
