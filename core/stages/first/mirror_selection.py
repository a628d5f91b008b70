# SPDX-License-Identifier: GPL-3.0-or-later
"""Mirror selection: regions of the start that begin as metal because each photograph shows other colours there."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import torch
from scipy.spatial import KDTree

from ...progress.protocol import Progress
from ...scene.dataset import Dataset
from ...scene.gaussians import quaternion_to
from .carved_hull import CarvedHull, carve_hull
from .colour_spread import colour_spread
from .layered_regions import SPACING_NEIGHBOURS, layered_regions
from .metal_selection import reason_against_metal
from .start import Start
from .start_trials import StartTrials

# Colour spread of a region over that of the other points, medians, from which it is a mirror. Parts of metal have 2.3 to 5.7 (a belt 1.9),
# those that trial fits miss 3.0 and more (gold, a rod, a chain, an arm ring); 28 other regions of nine objects .3 to 1.7, a cup's rim 2.2.
MIN_SPREAD = 2.6
LEAST_SPREAD = 1 / 255  # that the other points count for: photographs are no finer
MAX_METAL = 0.5  # fraction of a region's points that are metal already, from which it is left alone
MIN_DEPTH = 1.0  # spacings of the points below the carved hull, median, from which they are moved onto it
REACH = 0.1  # radii of the bound around a region's points within which the hull's surface is the region's
BESIDE = 0.03  # radii of the bound around the other points within which it is theirs
# Area of this surface over that of as many surfels as the region has, below which they stay: three parts of metal have .4 to .45, an arm
# ring whose hull is mostly that of the arm beside it .01.
MIN_COVERAGE = 0.2


@dataclass(frozen=True, eq=False)
class _Mirror:
    """Region (N,) bool of the start's points, and where they go: K points (K, 3) of a surface and their normals, or None to stay."""

    region: np.ndarray
    surface: tuple[np.ndarray, np.ndarray] | None


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
    reason = reason_against_metal(trials) or ("" if start.anchors else "the start has no depths of stereo")
    regions = [] if reason else _candidates(start, trials.dataset)
    if not regions:
        progress.decided("mirrors", False, reason or "no region whose points lie in several layers is left")
        return start
    spread = _spreads(start, trials.dataset, regions)
    mirrors = [_mirror(start, trials.dataset, region) for region, ratio in zip(regions, spread, strict=True) if ratio > MIN_SPREAD]
    found = f"{len(mirrors)} of {len(regions)} regions whose points lie in several layers"
    moved = sum(one.surface is not None for one in mirrors)
    ratios = ", ".join(f"{ratio:.1f}" for ratio in spread)
    progress.decided("mirrors", bool(mirrors), f"{found}, {moved} moved; colours differ {ratios} times as much as elsewhere")
    return _with_mirrors(start, mirrors) if mirrors else start


def _candidates(start: Start, dataset: Dataset) -> list[np.ndarray]:
    """Return the layered regions, masks (N,) bool, that are not metal yet."""
    points, normals = _oriented(start)
    metal = np.zeros(len(points), bool) if start.metal is None else start.metal.cpu().numpy()
    return [region for region in layered_regions(points, normals, dataset.bound.radius) if metal[region].mean() < MAX_METAL]


def _oriented(start: Start) -> tuple[np.ndarray, np.ndarray]:
    """Return the points and normals (N, 3) of a start's surfels."""
    return start.gaussians.position.T.double().cpu().numpy(), start.gaussians.normals().T.double().cpu().numpy()


def _spreads(start: Start, dataset: Dataset, regions: Sequence[np.ndarray]) -> list[float]:
    """Return the colour spread of each region over that of the points outside of all; 0 where too few views see it."""
    assert start.anchors is not None
    points, normals = _oriented(start)
    spread = colour_spread(dataset.train, start.anchors, points, normals, dataset.bound.radius)
    elsewhere = max(_median(spread[~np.any(regions, 0)]), LEAST_SPREAD)
    return [_median(spread[region]) / elsewhere for region in regions]


def _median(values: np.ndarray) -> float:
    """Return the median of the values (N,) that are known, 0 where none is."""
    known = values[np.isfinite(values)]
    return float(np.median(known)) if len(known) else 0.0


def _mirror(start: Start, dataset: Dataset, region: np.ndarray) -> _Mirror:
    """Return a region (N,) bool as a mirror, with the surface that its points are moved onto where they lie deep in its hull."""
    assert start.anchors is not None
    points, radius = _oriented(start)[0], dataset.bound.radius
    hull = carve_hull(dataset.train, start.anchors, points[region], radius)
    spacing = float(np.median(KDTree(points).query(points, SPACING_NEIGHBOURS + 1, workers=-1)[0][:, SPACING_NEIGHBOURS]))
    if not hull.has_surface or np.median(hull.depth(points[region])) < MIN_DEPTH * spacing:
        return _Mirror(region, None)
    place, normal = _own_surface(hull, points[region], points[~region], radius)
    covers = len(place) * hull.side**2 > MIN_COVERAGE * region.sum() * spacing**2
    return _Mirror(region, (place, normal) if covers else None)


def _own_surface(hull: CarvedHull, points: np.ndarray, others: np.ndarray, radius: float) -> tuple[np.ndarray, np.ndarray]:
    """Return the part of a hull's surface, points and normals (K, 3), that belongs to a region's points (M, 3) and not to others (N, 3)."""
    place, normal = hull.surface()
    own = KDTree(points).query(place, workers=-1)[0] < REACH * radius
    own &= KDTree(others).query(place, workers=-1)[0] > BESIDE * radius
    return place[own], normal[own]


def _with_mirrors(start: Start, mirrors: Sequence[_Mirror]) -> Start:
    """Return a start with mirrors as metal, whose surfels lie evenly on their surfaces, where they have them, and face outwards."""
    gaussians = start.gaussians
    position, quaternion, device = gaussians.position.clone(), gaussians.quaternion.clone(), gaussians.position.device
    metal = torch.from_numpy(np.any([one.region for one in mirrors], 0)).to(device)
    for one in mirrors:
        if one.surface is None:
            continue
        held = torch.from_numpy(one.region).to(device)
        place, normal = one.surface
        chosen = np.arange(int(one.region.sum())) * len(place) // int(one.region.sum())
        position[:, held] = position.new_tensor(place[chosen].T)
        quaternion[:, held] = quaternion_to(position.new_tensor(normal[chosen].T))
    moved = replace(gaussians, position=position, quaternion=quaternion)
    return replace(start, gaussians=moved, metal=metal if start.metal is None else metal | start.metal)
