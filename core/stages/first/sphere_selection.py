# SPDX-License-Identifier: GPL-3.0-or-later
"""Sphere selection: regions of virtual images that begin as balls of metal, where trial fits then predict the photographs better."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import torch

from ...progress.protocol import Progress
from .metal_selection import MIN_ERROR_RATIO, reason_against_metal
from .mirror_sphere import MIN_SURFELS, MirrorSphere, mirror_sphere, moved_onto
from .region_trial import gains_in_words, region_gains
from .start import Start
from .start_trials import StartTrials


def select_spheres(start: Start, trials: StartTrials, progress: Progress) -> Start:
    """Select the regions of the start that begin as balls of metal.

    The first stage does not leave the virtual images that stereo sees in a ball. Candidates are spheres in the hull of regions whose
    points lie in several layers. One trial fit has the start as it is, another has surfels on all spheres, as metal; each is compared
    where held-back views show it.

    Args:
        start: what the first stage starts with, with its metal.
        trials: see `select_metal`; `first.metal_regions` sets this choice, too.
        progress: see `select_metal`.

    Returns:
        The start with surfels moved onto the chosen spheres, and these as metal.

    Raises:
        Cancelled: the user stopped the work.
    """
    reason = reason_against_metal(trials) or ("" if start.anchors else "the start has no depths of stereo")
    spheres = [] if reason else _candidates(trials, start)
    if not spheres:
        progress.decided("mirror_spheres", False, reason or "no region whose points lie in several layers is a ball")
        return start
    found, moved = f"{len(spheres)} balls around regions whose points lie in several layers", with_spheres(start, spheres)
    if trials.settings.first.metal_regions == "on":
        chosen, evidence = spheres, f"{found}, as set"
    else:
        points = moved.points()
        progress.phase("spheres", trials.settings.first.trial_iterations)
        gains = region_gains(trials, (start, moved), 1, [sphere.holds(points) for sphere in spheres], progress)
        chosen = [sphere for sphere, gain in zip(spheres, gains, strict=True) if gain > MIN_ERROR_RATIO]
        evidence = f"{len(chosen)} of {found}; {gains_in_words(gains)}"
    progress.decided("mirror_spheres", bool(chosen), evidence)
    if len(chosen) == len(spheres):
        return moved
    return with_spheres(start, chosen) if chosen else start


def with_spheres(start: Start, spheres: Sequence[MirrorSphere]) -> Start:
    """Return a start with its surfels in spheres moved onto them, as metal.

    Args:
        start: what the first stage starts with.
        spheres: at least one.
    """
    points, device = start.points(), start.gaussians.position.device
    metal = torch.from_numpy(np.any([sphere.holds(points) for sphere in spheres], 0)).to(device)
    return replace(start, gaussians=moved_onto(start.gaussians, spheres), metal=metal if start.metal is None else metal | start.metal)


def _candidates(trials: StartTrials, start: Start) -> list[MirrorSphere]:
    """Return the spheres of the regions whose points lie in several layers."""
    assert start.anchors is not None
    points, dataset = start.points(), trials.dataset
    regions = trials.layered_regions(start)
    spheres = [mirror_sphere(dataset.train, start.anchors, points[region], dataset.bound.radius) for region in regions]
    return [sphere for sphere in spheres if sphere is not None and sphere.holds(points).sum() >= MIN_SURFELS]
