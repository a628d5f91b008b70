# SPDX-License-Identifier: GPL-3.0-or-later
"""Initial Gaussians from dense stereo: surfels on the fused points, with the visual hull or random points where stereo found nothing."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial

import numpy as np
from scipy.spatial import KDTree

from ...datasets.visual_hull import VisualHull, visual_hull
from ...progress.protocol import Progress
from ...scene.dataset import Dataset, light_rotations
from ...stereo.depth_bounds import depth_bounds
from ...stereo.depth_map import DepthMap
from ...stereo.estimation import Depths, estimate_depth_maps
from ...stereo.fusion import fuse_points
from ...stereo.settings import StereoSettings
from ...stereo.thinning import thinned
from .depth_evidence import DepthEvidence
from .free_space import in_free_space
from .initialization import FAINT_OPACITY, random_points
from .masked_starts import MaskedStarts
from .stereo_start import CLEARANCE_RADII, MIN_SUPPORT_MASKED, MIN_SUPPORT_UNMASKED, FoundByStereo, StereoStart, joined_surfels, unexplained

MAX_STEREO_SHARE = 0.65  # without masks: largest share of the surfels that lie on stereo's points
FILLER_SHARE = 0.1  # without masks: share of the surfels that are random points, for what stereo did not see
MIN_POINT_RATIO = 0.08  # stereo's points over the budget of surfels below which there is no stereo start
MAX_ERROR_RATIO = 0.9  # reprojection error at stereo's depth over that at the hull's below which a region takes stereo's points
COMPARED_VIEWS = 4  # views that each view is compared with
MIN_REGION_SHARE = 0.2  # share of stereo's points in such regions below which all of them are no start: a chair (.1) loses 1 dB


def from_stereo(dataset: Dataset, count: int, seed: int, progress: Progress, *, everywhere: bool = False) -> list[StereoStart] | None:
    """Place surfels on the points of dense stereo, and on the visual hull or at random where stereo says nothing.

    With masks, stereo searches inside the visual hull, and there are up to two starts. In the first, a region takes stereo's points where
    the photographs agree better at their depth than at the hull's and where it differs by more than a pixel, and otherwise the hull's. The
    second takes all of stereo's points. It is better where the hull is also wrong between these regions, and worse where stereo matches
    reflections.
    Points of the hull fill the gaps that fewer than MIN_VIEWS_THROUGH views look through, but they close hollows without texture.
    `StereoStart.opened` makes the same start with open gaps: points of the hull that GUESSED_SHARE_THROUGH of the views that see them look
    through are left out, and all of stereo's points lie there, and those that fewer views agree on. `StereoStart.vessel` makes it with
    the inside of a vessel behind its mouth (`find_vessel`).

    Without masks, there is one start, and stereo's points in free space are left out: plain backgrounds and reflections match at false
    depths. Random points are added, likewise outside free space.

    Args:
        dataset: training views, bound and sparse points.
        count: most surfels.
        seed: seed of stereo and of the samples.
        progress: receives the phase "stereo" and may cancel.
        everywhere: only the start on all of stereo's points, without comparing regions.

    Returns:
        The starts, the one by regions first; none where no region is better. None where stereo found too few points to start on.

    Raises:
        Cancelled: the user stopped the work.
    """
    rng = np.random.default_rng(seed)
    if not dataset.has_alpha:
        known = None if dataset.points is None else dataset.points.position
        bounds = depth_bounds([view.camera for view in dataset.train], dataset.points, dataset.bound)
        found = _search(dataset, (*bounds, None), known, count, seed, progress)
        return None if found is None else [_with_random_points(dataset, found, bounds[0], count, rng)]
    hull = visual_hull(dataset.train, dataset.bound)
    bounds = hull_bounds(dataset, hull)
    found = _search(dataset, bounds, None, count, seed, progress)
    if found is None:
        return None
    *sampled, area = hull.sample(count, rng)
    starts = MaskedStarts(dataset, found, hull, (sampled[0], sampled[1]), area, bounds[2], count, seed)
    every = np.ones(len(found.points.position), bool), np.zeros(len(sampled[0]), bool)
    on_all = partial(starts.with_closed_gaps, "stereo everywhere", *every)
    if everywhere:
        return [on_all()]
    chosen, kept, share = _regions(dataset, found, bounds[2], sampled[0])
    if not chosen.any():
        return []
    by_regions = starts.with_closed_gaps("stereo by regions", chosen, kept)
    return [by_regions] if share < MIN_REGION_SHARE else [by_regions, on_all()]


def _search(
    dataset: Dataset,
    bounds: tuple[Depths, Depths, list[np.ndarray] | None],
    known: np.ndarray | None,
    count: int,
    seed: int,
    progress: Progress,
) -> FoundByStereo | None:
    """Run stereo within depth bounds and fuse its points; None where they are too few for `count` surfels."""
    settings = StereoSettings() if light_rotations(dataset.train) is None else StereoSettings(brightness=0.0)
    nearest, farthest, initial = bounds
    maps = estimate_depth_maps(dataset.train, nearest, farthest, known, settings, seed, progress, initial)
    support = MIN_SUPPORT_MASKED if dataset.has_alpha else MIN_SUPPORT_UNMASKED
    points = fuse_points(maps, [view.colour for view in dataset.train], support, settings)
    return FoundByStereo(maps, points) if len(points.position) >= MIN_POINT_RATIO * count else None


def _evidence(dataset: Dataset, maps: list[DepthMap], hull_depth: list[np.ndarray]) -> DepthEvidence:
    """Compare stereo's depths, the hull's where it has none, with the hull's."""
    stereo = [np.where(one.support >= MIN_SUPPORT_MASKED, one.depth, depth) for one, depth in zip(maps, hull_depth, strict=True)]
    sources = [one.witnesses[:COMPARED_VIEWS] for one in maps]
    return DepthEvidence.collect(dataset.train, dataset.bound, (hull_depth, stereo), sources, StereoSettings().relative_depth)


def _regions(
    dataset: Dataset, found: FoundByStereo, hull_depth: list[np.ndarray], other: np.ndarray
) -> tuple[np.ndarray, np.ndarray, float]:
    """Divide the surface between stereo and the hull; see `from_stereo`.

    Args:
        dataset: views with masks.
        found: points found by stereo, N.
        hull_depth: (H, W) depth of the hull in each view.
        other: (M, 3) points of the hull.

    Returns:
        (N,) True for the points of stereo that are taken, (M,) True for those of the hull that are kept whatever lies near them, and the
        share of stereo's points at which the photographs agree better.
    """
    points, evidence = found.points.position, _evidence(dataset, found.maps, hull_depth)
    better = evidence.ratio(points) < MAX_ERROR_RATIO
    # Stereo's noise is about a pixel: where it is so near to the hull, the hull is the better start.
    size = pixel_size(dataset)
    apart = KDTree(other).query(points, workers=-1)[0] > size
    agreed = KDTree(points).query(other, workers=-1)[0] <= size
    return better & apart, agreed | (evidence.ratio(other) >= MAX_ERROR_RATIO), float(better.mean())


def _with_random_points(
    dataset: Dataset, found: FoundByStereo, nearest: Sequence[float], count: int, rng: np.random.Generator
) -> StereoStart:
    """Place surfels on stereo's points outside free space, and faint ones at random; `nearest` is the least depth searched in each view."""
    reach = CLEARANCE_RADII * dataset.bound.radius
    seen = ~in_free_space(found.points, found.maps, nearest, reach, MIN_SUPPORT_UNMASKED)
    points = thinned(found.points.select(seen), int(MAX_STEREO_SHARE * count))
    other, other_normal = random_points(dataset, int(FILLER_SHARE * count), rng)
    keep = unexplained(other, points, found.maps, reach)
    return StereoStart("stereo", *joined_surfels(dataset, points, other[keep], other_normal[keep], FAINT_OPACITY), found.maps)


def pixel_size(dataset: Dataset) -> float:
    """Return the median size of a pixel at the bound's centre, world units."""
    centre = np.asarray(dataset.bound.centre)
    return float(np.median([np.linalg.norm(view.camera.centre - centre) / view.camera.fx for view in dataset.train]))


def hull_bounds(dataset: Dataset, hull: VisualHull) -> tuple[list[np.ndarray], list[np.ndarray], list[np.ndarray]]:
    """Return the nearest and the farthest depth that stereo searches in each view, and depths to start near, all (H, W), from the hull."""
    found = hull.depths([view.camera for view in dataset.train])
    nearest = [np.where(enter > 0, enter - hull.step, 0).astype(np.float32) for enter, _ in found]
    farthest = [np.where(enter > 0, leave + hull.step, 0).astype(np.float32) for enter, leave in found]
    return nearest, farthest, [enter for enter, _ in found]
