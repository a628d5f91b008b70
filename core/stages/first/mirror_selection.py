# SPDX-License-Identifier: GPL-3.0-or-later
"""Mirror selection: regions of the start that begin as metal because each photograph shows other colours there."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import torch

from ...progress.protocol import Progress
from ...scene.dataset import Dataset
from .colour_spread import colour_spread
from .hull_surface import hull_surface, moved_onto_hulls
from .metal_selection import reason_against_metal, unmetallic_regions
from .start import Start
from .start_trials import StartTrials

# Colour spread of a region over that of the other points, medians, from which it is a mirror. Parts of metal have 2.3 to 5.7 (a belt 1.9),
# those that trial fits miss 3.0 and more (gold, a rod, a chain, an arm ring); 28 other regions of nine objects .3 to 1.7, a cup's rim 2.2.
MIN_SPREAD = 2.6
# The spread itself, encoded, from which it is a mirror: metal has .07 to .21 (balls .05), highlights and reflections in gloss up to .063.
MIN_COLOUR_CHANGE = 0.067


def select_mirrors(start: Start, trials: StartTrials, progress: Progress) -> Start:
    """Select the regions of the start that begin as metal because their colours change from view to view.

    A trial fit is too brief for a mirror to be told by its reflections where it shows much of the object itself, or where the light is
    known little: points that follow virtual images predict held-back views better. But no view sees them as the others do. Candidates are
    the regions whose points lie in several layers and that are not metal yet. Where the points lie deep in the hull that matt points
    carve around them, they are moved onto it.

    Args:
        start: what the first stage starts with, with its metal.
        trials: see `select_metal`; `first.metal_regions` sets this choice, too, where it is "off".
        progress: receives the decision.
    """
    reason = reason_against_metal(trials, by_trials=False) or ("" if start.anchors else "the start has no depths of stereo")
    regions = [] if reason else unmetallic_regions(start, trials)
    if not regions:
        progress.decided("mirrors", False, reason or "no region whose points lie in several layers is left")
        return start
    spreads, elsewhere = _spreads(start, trials.dataset, regions)
    least = max(MIN_SPREAD * elsewhere, MIN_COLOUR_CHANGE)
    mirrors = [region for region, spread in zip(regions, spreads, strict=True) if spread > least]
    carved = [hull_surface(start, trials.dataset, region) for region in mirrors]
    surfaces = [one for one in carved if one is not None]
    found = f"{len(mirrors)} of {len(regions)} regions whose points lie in several layers, {len(surfaces)} moved"
    evidence = f"colours differ by {', '.join(f'{spread:.3f}' for spread in spreads)}, elsewhere {elsewhere:.3f}"
    progress.decided("mirrors", bool(mirrors), f"{found}; {evidence}")
    if not mirrors:
        return start
    metal = torch.from_numpy(np.any(mirrors, 0)).to(start.gaussians.position.device)
    return replace(
        start, gaussians=moved_onto_hulls(start.gaussians, surfaces), metal=metal if start.metal is None else metal | start.metal
    )


def _spreads(start: Start, dataset: Dataset, regions: Sequence[np.ndarray]) -> tuple[list[float], float]:
    """Return the colour spread of each region, 0 where too few views see it, and that of the points outside of all."""
    assert start.anchors is not None
    spread = colour_spread(dataset.train, start.anchors, start.points(), start.normals(), dataset.bound.radius)
    return [_median(spread[region]) for region in regions], _median(spread[~np.any(regions, 0)])


def _median(values: np.ndarray) -> float:
    """Return the median of the values (N,) that are known, 0 where none is."""
    known = values[np.isfinite(values)]
    return float(np.median(known)) if len(known) else 0.0
