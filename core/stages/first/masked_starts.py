# SPDX-License-Identifier: GPL-3.0-or-later
"""Starts with masks, on points of dense stereo and of the visual hull: with closed gaps, with open gaps, or as a vessel."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from scipy.spatial import KDTree

from ...datasets.visual_hull import VisualHull
from ...scene.dataset import Dataset
from ...stereo.fusion import OrientedPoints, fuse_points
from ...stereo.thinning import thinned
from .free_space import views_of, views_through
from .initialization import OPACITY
from .stereo_start import CLEARANCE_RADII, FoundByStereo, StereoStart, apart, joined_surfels, unexplained
from .vessel import find_vessel

MIN_SUPPORT_IN_GAPS = 2  # with masks, of points in gaps: 80 % of them are right on a pine cone, 63 % in a plain cup, of the hull's 60 %
# Share of the views that see a point of the hull in which any depth of stereo, confirmed by other views or not, lies behind it, from which
# it may close a hollow. Trial fits with open gaps at .6, .7, .8, .9: a watering can 32.2, 32.2, 32.1, 31.9 dB, closed 31.6; a plain cup
# 37.7, 37.9, 37.8, not tried, closed 37.3; a pine cone 31.3, 31.4, 31.4, 31.3, closed 30.6. A tenth of all views found the hull's wrong
# points as well, but also 37 % of the can's right ones (now 6 %), 7 % of the cup's (3), 59 % of rocker_corner's (24), 41 % of
# suzanne_mixed's (5). Whole jobs: .7 costs the cup's albedo, relit images and new views .2 dB each against .8.
GUESSED_SHARE_THROUGH = 0.8
MIN_OPENED = 0.02  # share of the hull's points that open gaps leave out, below which they make no difference
# Of the views that see or look through a point in a vessel's hollow, share from which nothing is there. Reflections in a glossy bowl have
# .43 to .63 (quartiles); with .4 in place of .7 its trial fit gains .2 dB, a box with a ball loses .2 dB.
SHARE_THROUGH_CONTENTS = 0.5
# Share of stereo's points in a vessel's hollow where nothing is, or of the hull's at its mouth that the start lies on, from which they are
# a lid. Mug, watering can, lacquer bowl, glossy bowl, cardboard box: .37, .38, .32, .40, .21 of stereo's. Trial fits refused a vessel on
# a part in a corner .07, a plain cup whose inside stereo finds .06, a crate with apples .06, a shelf .02, a pot with leaves .003.
MIN_LID_SHARE = 0.12


@dataclass(frozen=True, eq=False)
class MaskedStarts:
    """Starts with masks, on points of stereo and of the visual hull.

    Attributes:
        dataset: views with masks.
        found: depth maps and N points of stereo.
        voxels: of the visual hull.
        hull: points (M, 3) of the hull and their normals (M, 3).
        area: of the hull, world units.
        hull_depth: (H, W) depth of the hull in each view.
        count: most surfels.
        seed: of the points of a vessel's inside.
    """

    dataset: Dataset
    found: FoundByStereo
    voxels: VisualHull
    hull: tuple[np.ndarray, np.ndarray]
    area: float
    hull_depth: list[np.ndarray]
    count: int
    seed: int

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
        keep = kept | unexplained(self.hull[0], points, self.found.maps, self.reach)
        opened = partial(self.with_open_gaps, f"{name} with open gaps", chosen, keep)
        vessel = partial(self.as_vessel, f"{name} as a vessel", chosen, keep)
        return replace(self._start(name, points, float(chosen.mean()), keep), opened=opened, vessel=vessel)

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
        weaker = weaker.select(apart(weaker.position, points, self.reach))
        keep = keep & apart(self.hull[0], weaker, self.reach)
        area = float(chosen.mean()) + len(weaker.position) / len(chosen)
        return self._start(name, points.select(chosen).joined(weaker), area, keep)

    def as_vessel(self, name: str, chosen: np.ndarray, keep: np.ndarray, least_depth: float) -> StereoStart | None:
        """Place surfels on the inside of a vessel in place of points that close its mouth, or lie in its wall or where nothing is.

        Args:
            name: name of the start.
            chosen: (N,) True for the points of stereo to take.
            keep: (M,) True for the points of the hull that the start with closed gaps lies on.
            least_depth: relative depth from which a part of the hull is a mouth, see `find_vessel`.

        Returns:
            The start; None where nothing tells that the object is a vessel, or that the start with closed gaps closes its mouth.
        """
        vessel = find_vessel(self.voxels, self.hull, self.found.maps, self.hull_depth, self.dataset.bound.radius, least_depth)
        if vessel is None:
            return None
        points = self.found.points
        in_hollow = vessel.is_in_hollow(points.position, self.reach)
        lid = in_hollow & self._is_free(points.position)
        if max(keep[vessel.mouth].mean(), lid.sum() / max(in_hollow.sum(), 1)) < MIN_LID_SHARE:
            return None
        false = lid | vessel.faces_wall(points.position, points.normal)
        chosen = (chosen | vessel.is_near(points.position)) & ~false
        keep = keep & ~vessel.mouth & ~vessel.is_in_hollow(self.hull[0], self.reach)
        place, normal, area = vessel.surface(len(keep), np.random.default_rng(self.seed))
        new = apart(place, points.select(chosen), min(self.reach, 0.6 * vessel.thickness))
        inside = place[new], normal[new], float(new.sum()) / len(keep) * area / self.area
        return self._start(name, points.select(chosen), float(chosen.mean()), keep, inside)

    def _is_free(self, points: np.ndarray) -> np.ndarray:
        """Return (N,) True for points (N, 3) that most views look through, by any depth of stereo: nothing is there."""
        maps = self.found.maps
        seen = views_of(points, [one.camera for one in maps], [one.depth for one in maps], self.reach)
        through = views_through(points, maps, self.reach, 0)
        return through >= SHARE_THROUGH_CONTENTS * np.maximum(seen + through, 1)

    def _closes_hollow(self) -> np.ndarray:
        """Return (M,) True for the points of the hull that may close a hollow, see GUESSED_SHARE_THROUGH."""
        seen = views_of(self.hull[0], [one.camera for one in self.found.maps], self.hull_depth, self.reach)
        return views_through(self.hull[0], self.found.maps, self.reach, 0) >= np.maximum(GUESSED_SHARE_THROUGH * seen, 1)

    def _start(
        self,
        name: str,
        points: OrientedPoints,
        area: float,
        keep: np.ndarray,
        inside: tuple[np.ndarray, np.ndarray, float] | None = None,
    ) -> StereoStart:
        """Place at most `count` surfels on points of stereo, on those of the hull that are kept, and on those of a vessel's inside.

        All of them cover their parts of the surface evenly: their numbers are in proportion to the areas.

        Args:
            name: name of the start.
            points: of stereo.
            area: of their surface, as a fraction of the surface on which stereo found points.
            keep: (M,) True for the points of the hull to take.
            inside: points (K, 3), normals (K, 3) and area, as a fraction of the hull's; None for none.
        """
        place, normal, share = self.hull[0][keep], self.hull[1][keep], float(keep.mean())
        if inside is not None:
            place, normal, share = np.concatenate([place, inside[0]]), np.concatenate([normal, inside[1]]), share + inside[2]
            mixed = np.random.default_rng(self.seed).permutation(len(place))
            place, normal = place[mixed], normal[mixed]
        points = thinned(points, round(area / max(area + share, 1e-9) * self.count))
        left = self.count - len(points.position)
        return StereoStart(name, *joined_surfels(self.dataset, points, place[:left], normal[:left], OPACITY), self.found.maps)
