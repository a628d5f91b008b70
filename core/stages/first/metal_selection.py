# SPDX-License-Identifier: GPL-3.0-or-later
"""Metal selection: regions of the start that begin as metal, where trial fits then predict the photographs better."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import torch

from ...progress.protocol import Progress
from ...scene.dataset import Dataset
from ...settings.schema import Settings
from .layered_regions import layered_regions
from .material_class import METAL, MaterialClass
from .region_trial import region_gains
from .start_selection import Start
from .trial_fits import MIN_HOLD_BACK_VIEWS

# A region's squared error without metal over that with it, on held-back views, from which it begins as metal: 1 dB. On ten
# objects, ears, a shackle and arm rings of metal gain 1.1 to 2.7 dB; a belt and a ball that stereo sees too deep (see
# `select_spheres`) do not, and some 40 regions of other materials gain at most 0.9 dB.
MIN_ERROR_RATIO = 1.25


def select_metal(
    dataset: Dataset, settings: Settings, start: Start, material_class: MaterialClass, progress: Progress, crop: bool = False
) -> Start:
    """Select the regions of the start that begin as metal.

    All surfels of a glossy object start with hardly any metallic, and the optimisation does not raise it enough: in parts of metal they
    follow the virtual images. Candidates are the regions whose points lie in several layers. One trial fit has all of them as metal,
    another has none; each region is compared where held-back views show it.

    Args:
        dataset: views.
        settings: settings of the job; `first.metal_regions` decides without evidence where it is "on" or "off".
        start: what the first stage starts with.
        material_class: class of the object.
        progress: receives steps and the decision, and may cancel.
        crop: crop the images of the trial fits to the object.

    Returns:
        The start with its metal.

    Raises:
        Cancelled: the user stopped the work.
    """
    reason = reason_against_metal(dataset, settings, material_class)
    if reason:
        progress.decided("metal_regions", False, reason)
        return start
    points = start.gaussians.position.T.double().cpu().numpy()
    regions = layered_regions(points, start.gaussians.normals().T.double().cpu().numpy(), dataset.bound.radius)
    found = f"{len(regions)} regions whose points lie in several layers"
    if settings.first.metal_regions == "on":
        chosen, evidence = regions, f"{found}, as set"
    elif regions:
        progress.phase("metal", settings.first.trial_iterations)
        gains = region_gains(dataset, settings, (start, _as_metal(start, regions)), 0, material_class, regions, progress, crop)
        chosen = [region for region, gain in zip(regions, gains, strict=True) if gain > MIN_ERROR_RATIO]
        evidence = f"{len(chosen)} of {found}; held-back views: {', '.join(f'{10 * math.log10(gain):+.1f} dB' for gain in gains)}"
    else:
        chosen, evidence = [], "nowhere do the start's points lie in several layers"
    progress.decided("metal_regions", bool(chosen), evidence)
    return _as_metal(start, chosen) if chosen else start


def _as_metal(start: Start, regions: list[np.ndarray]) -> Start:
    """Return a start with regions, masks (N,) bool, as metal."""
    return replace(start, metal=torch.from_numpy(np.any(regions, 0)).to(start.gaussians.position.device))


def reason_against_metal(dataset: Dataset, settings: Settings, material_class: MaterialClass) -> str:
    """Return the reason why no region is tried as metal, empty where there is none.

    Args:
        dataset: views.
        settings: settings of the job.
        material_class: class of the object.
    """
    if settings.first.metal_regions == "off":
        return "as set"
    if not dataset.has_alpha:
        return "not tried without masks"
    if not material_class.split_sum:
        return "a low-gloss object has no reflections"
    if material_class == METAL:
        return "the whole object begins as metal"
    if len(dataset.train) < MIN_HOLD_BACK_VIEWS:
        return f"{len(dataset.train)} photographs, too few to hold any back"
    return ""
