# SPDX-License-Identifier: GPL-3.0-or-later
"""Initial Gaussians from dense stereo: surfels on the fused points, with the visual hull or random points where stereo found nothing."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np
from scipy.spatial import KDTree

from ...io.srgb import decode_srgb
from ...progress.protocol import Progress
from ...scene.dataset import Dataset, light_rotations
from ...scene.gaussians import Gaussians
from ...stereo.depth_bounds import depth_bounds
from ...stereo.depth_map import DepthMap
from ...stereo.estimation import Depths, estimate_depth_maps
from ...stereo.fusion import OrientedPoints, fuse_points
from ...stereo.settings import StereoSettings
from ...stereo.thinning import thinned
from .depth_evidence import DepthEvidence
from .free_space import in_free_space, views_of, views_through
from .initialization import FAINT_OPACITY, OPACITY, SURFACE_SPREAD, observed_colour, random_points, spatial_order, surface_spacing, surfels
from .visual_hull import VisualHull, visual_hull

MIN_SUPPORT_MASKED, MIN_SUPPORT_UNMASKED = 3, 2  # views that must agree with a point: captures overlap less than turntables
MIN_SUPPORT_IN_GAPS = 2  # with masks, of points in gaps: 80 % of them are right on a pine cone, 63 % in a plain cup, of the hull's 60 %
MAX_STEREO_SHARE = 0.65  # without masks: largest share of the surfels that lie on stereo's points
FILLER_SHARE = 0.1  # without masks: share of the surfels that are random points, for what stereo did not see
MIN_POINT_RATIO = 0.08  # stereo's points over the budget of surfels below which there is no stereo start
MAX_ERROR_RATIO = 0.9  # reprojection error at stereo's depth over that at the hull's below which a region takes stereo's points
COMPARED_VIEWS = 4  # views that each view is compared with
MIN_REGION_SHARE = 0.2  # share of stereo's points in such regions below which all of them are no start: a chair (.1) loses 1 dB
CLEARANCE_RADII = 0.03  # radii of the bound around stereo's points without other points; tolerance of the free-space test
MIN_VIEWS_THROUGH = 2  # views whose depth lies behind a point, from which the point is in free space
# Share of the views that see a point of the hull in which any depth of stereo, confirmed by other views or not, lies behind it, from which
# it may close a hollow. Trial fits with open gaps at .6, .7, .8, .9: a watering can 32.2, 32.2, 32.1, 31.9 dB, closed 31.6; a plain cup
# 37.7, 37.9, 37.8, not tried, closed 37.3; a pine cone 31.3, 31.4, 31.4, 31.3, closed 30.6. A tenth of all views found the hull's wrong
# points as well, but also 37 % of the can's right ones (now 6 %), 7 % of the cup's (3), 59 % of rocker_corner's (24), 41 % of
# suzanne_mixed's (5). Whole jobs: .7 costs the cup's albedo, relit images and new views .2 dB each against .8.
GUESSED_SHARE_THROUGH = 0.8
MIN_OPENED = 0.02  # share of the hull's points that open gaps leave out, below which they make no difference


@dataclass(frozen=True, eq=False)
class StereoStart:
    """Initial Gaussians that dense stereo contributed to.

    Attributes:
        name: name of the start, in messages.
        gaussians: initial Gaussians on stereo's points and elsewhere.
        share: fraction of them that lie on stereo's points.
        maps: depth map of each training view.
        opened: makes the same start with open gaps, see `from_stereo`, or None where it is almost the same; None without masks.
    """

    name: str
    gaussians: Gaussians
    share: float
    maps: list[DepthMap]
    opened: Callable[[], StereoStart | None] | None = None


@dataclass(frozen=True, eq=False)
class _Found:
    """Depth maps and fused points of stereo."""

    maps: list[DepthMap]
    points: OrientedPoints


@dataclass(frozen=True, eq=False)
class _MaskedStarts:
    """Starts with masks, on points of stereo and of the visual hull.

    Attributes:
        dataset: views with masks.
        found: depth maps and N points of stereo.
        hull: points (M, 3) of the hull and their normals (M, 3).
        hull_depth: (H, W) depth of the hull in each view.
        count: most surfels.
    """

    dataset: Dataset
    found: _Found
    hull: tuple[np.ndarray, np.ndarray]
    hull_depth: list[np.ndarray]
    count: int

    @property
    def reach(self) -> float:
        """Distance around stereo's points without points of the hull, world units."""
        return CLEARANCE_RADII * self.dataset.bound.radius

    def with_closed_gaps(self, name: str, chosen: np.ndarray, kept: np.ndarray) -> StereoStart:
        """Place surfels on some of stereo's points, and on the hull's where they are kept or fill a gap.

        Args:
            name: name of the start.
            chosen: (N,) True for the points of stereo to take.
            kept: (M,) True for the points of the hull that are taken whatever lies near them.
        """
        points = self.found.points.select(chosen)
        keep = kept | _unexplained(self.hull[0], points, self.found.maps, self.reach)
        opened = partial(self.with_open_gaps, f"{name} with open gaps", chosen, keep)
        return self._start(name, points, float(chosen.mean()), keep, opened)

    def with_open_gaps(self, name: str, chosen: np.ndarray, keep: np.ndarray) -> StereoStart | None:
        """Leave out points of the hull that close hollows, and take all of stereo's points there, also those that fewer views agree on.

        Args:
            name: name of the start.
            chosen: (N,) True for the points of stereo to take.
            keep: (M,) True for the points of the hull that the start with closed gaps lies on.

        Returns:
            The start; None where it leaves out less than MIN_OPENED of the hull's points.
        """
        points, left_out = self.found.points, keep & self._closes_hollow()
        if left_out.mean() < MIN_OPENED:
            return None
        keep = keep & ~left_out
        # Without texture, the photographs agree with the hull as well as with stereo: where the hull is left out, stereo alone is left.
        chosen = chosen | (KDTree(self.hull[0][keep]).query(points.position, workers=-1)[0] > self.reach)
        weaker = fuse_points(self.found.maps, [view.colour for view in self.dataset.train], MIN_SUPPORT_IN_GAPS)
        weaker = weaker.select(_apart(weaker.position, points, self.reach))
        keep = keep & _apart(self.hull[0], weaker, self.reach)
        area = float(chosen.mean()) + len(weaker.position) / len(chosen)
        return self._start(name, points.select(chosen).joined(weaker), area, keep)

    def _closes_hollow(self) -> np.ndarray:
        """Return (M,) True for the points of the hull that may close a hollow, see GUESSED_SHARE_THROUGH."""
        seen = views_of(self.hull[0], [one.camera for one in self.found.maps], self.hull_depth, self.reach)
        return views_through(self.hull[0], self.found.maps, self.reach, 0) >= np.maximum(GUESSED_SHARE_THROUGH * seen, 1)

    def _start(
        self, name: str, points: OrientedPoints, area: float, keep: np.ndarray, opened: Callable[[], StereoStart | None] | None = None
    ) -> StereoStart:
        """Place at most `count` surfels on points of stereo and on those of the hull that are kept, (M,) True.

        `area` is that of the points' surface, as a fraction of the surface on which stereo found points.
        """
        # Both cover their parts of the surface evenly: their numbers are in proportion to the areas.
        points = thinned(points, round(area / max(area + keep.mean(), 1e-9) * self.count))
        left = self.count - len(points.position)
        on_hull = self.hull[0][keep][:left], self.hull[1][keep][:left]
        return StereoStart(name, *_joined(self.dataset, points, *on_hull, OPACITY), self.found.maps, opened)


def from_stereo(dataset: Dataset, count: int, seed: int, progress: Progress, *, everywhere: bool = False) -> list[StereoStart] | None:
    """Place surfels on the points of dense stereo, and on the visual hull or at random where stereo says nothing.

    With masks, stereo searches inside the visual hull, and there are up to two starts. In the first, a region takes stereo's points where
    the photographs agree better at their depth than at the hull's and where it differs by more than a pixel, and otherwise the hull's. The
    second takes all of stereo's points. It is better where the hull is also wrong between these regions, and worse where stereo matches
    reflections.
    Points of the hull fill the gaps that fewer than MIN_VIEWS_THROUGH views look through, but they close hollows without texture.
    `StereoStart.opened` makes the same start with open gaps: points of the hull that GUESSED_SHARE_THROUGH of the views that see them look
    through are left out, and all of stereo's points lie there, and those that fewer views agree on.

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
    sampled = hull.sample(count, rng)[:2]
    starts = _MaskedStarts(dataset, found, sampled, bounds[2], count)
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
) -> _Found | None:
    """Run stereo within depth bounds and fuse its points; None where they are too few for `count` surfels."""
    settings = StereoSettings() if light_rotations(dataset.train) is None else StereoSettings(brightness=0.0)
    nearest, farthest, initial = bounds
    maps = estimate_depth_maps(dataset.train, nearest, farthest, known, settings, seed, progress, initial)
    support = MIN_SUPPORT_MASKED if dataset.has_alpha else MIN_SUPPORT_UNMASKED
    points = fuse_points(maps, [view.colour for view in dataset.train], support, settings)
    return _Found(maps, points) if len(points.position) >= MIN_POINT_RATIO * count else None


def _evidence(dataset: Dataset, maps: list[DepthMap], hull_depth: list[np.ndarray]) -> DepthEvidence:
    """Compare stereo's depths, the hull's where it has none, with the hull's."""
    stereo = [np.where(one.support >= MIN_SUPPORT_MASKED, one.depth, depth) for one, depth in zip(maps, hull_depth, strict=True)]
    sources = [one.witnesses[:COMPARED_VIEWS] for one in maps]
    return DepthEvidence.collect(dataset.train, dataset.bound, (hull_depth, stereo), sources, StereoSettings().relative_depth)


def _regions(dataset: Dataset, found: _Found, hull_depth: list[np.ndarray], other: np.ndarray) -> tuple[np.ndarray, np.ndarray, float]:
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


def _with_random_points(dataset: Dataset, found: _Found, nearest: Sequence[float], count: int, rng: np.random.Generator) -> StereoStart:
    """Place surfels on stereo's points outside free space, and faint ones at random; `nearest` is the least depth searched in each view."""
    reach = CLEARANCE_RADII * dataset.bound.radius
    seen = ~in_free_space(found.points, found.maps, nearest, reach, MIN_SUPPORT_UNMASKED)
    points = thinned(found.points.select(seen), int(MAX_STEREO_SHARE * count))
    other, other_normal = random_points(dataset, int(FILLER_SHARE * count), rng)
    keep = _unexplained(other, points, found.maps, reach)
    return StereoStart("stereo", *_joined(dataset, points, other[keep], other_normal[keep], FAINT_OPACITY), found.maps)


def _unexplained(others: np.ndarray, points: OrientedPoints, maps: list[DepthMap], reach: float) -> np.ndarray:
    """Return (N,) True for the others (N, 3) that none of the points is near and that few views look through."""
    return _apart(others, points, reach) & (views_through(others, maps, reach, MIN_SUPPORT_UNMASKED) < MIN_VIEWS_THROUGH)


def _apart(others: np.ndarray, points: OrientedPoints, reach: float) -> np.ndarray:
    """Return (N,) True for the others (N, 3) that are farther than `reach` from all points."""
    if not len(points.position):
        return np.ones(len(others), bool)
    return KDTree(points.position).query(others, workers=-1)[0] > reach


def _joined(
    dataset: Dataset, points: OrientedPoints, other: np.ndarray, other_normal: np.ndarray, opacity: float
) -> tuple[Gaussians, float]:
    """Make surfels in spatial order of stereo's points, and of other points (N, 3) with normals (N, 3) and an opacity.

    Returns:
        The surfels, and the fraction of them that lie on stereo's points.
    """
    place, normal = np.concatenate([points.position, other]), np.concatenate([points.normal, other_normal])
    colour = np.concatenate([decode_srgb(points.colour), observed_colour(dataset.train, other, other_normal)])
    opacities = np.repeat([OPACITY, opacity], [len(points.position), len(other)])
    order, scale = spatial_order(place), SURFACE_SPREAD * surface_spacing(place, dataset.bound.radius)
    gaussians = surfels(place[order], normal[order], colour[order], scale[order], opacities[order])
    return gaussians, len(points.position) / max(len(place), 1)


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
