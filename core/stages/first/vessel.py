# SPDX-License-Identifier: GPL-3.0-or-later
"""Vessel: a visual hull without the hollow behind its mouth, for cups and cans whose plain inside dense stereo does not see.

A visual hull closes the mouth of a vessel. Stereo finds little on an inside without texture, but what it guesses there lies mostly as deep
as the inside does. So the hollow is taken to be the space that lies one wall's thickness behind the hull's surface, the mouth apart.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.ndimage import binary_dilation, distance_transform_edt, gaussian_filter, label, map_coordinates
from scipy.spatial import KDTree

from ...datasets.visual_hull import VisualHull
from ...stereo.depth_map import DepthMap
from .vessel_mouths import vessel_mouths

THICKNESSES = (0.035, 0.05, 0.07, 0.1)  # of a wall that are tried, radii of the bound
UNKNOWN_THICKNESS = 0.05  # where stereo's depths do not tell it
# Stereo's depth behind a mouth, median, in units of that of the inside at the first thickness, from which it may be a mouth. A watering
# can, a plain cup and a mug have .88, .91 and .83; a bowl in lacquer .69, a glossy one, whose reflections mislead stereo, .46; a crate with
# apples and a part in a corner .57, the compartments of a shelf .23 to .81, a pot with leaves 1.03: these four have no lid
# (`masked_starts.MIN_LID_SHARE`). Walls and undersides have at most .35.
MIN_RELATIVE_DEPTH = 0.4
MIN_TELLING_DEPTH = 0.75  # likewise, from which it tells the wall's thickness
PROBED_VIEWS = 6  # one view of so many is compared
MIN_HOLLOW_DEPTH = 0.08  # radii of the bound by which the inside must lie behind the hull at a pixel for it to be compared
MARGIN = 0.01  # radii of the bound behind the inside's surface up to which a point is on it
BLUR_VOXELS = 0.7  # standard deviation of the blur of the inside's surface
NORMAL_BLUR_VOXELS = 1.0  # and of the one along whose slope its normals lie
REACH_VOXELS = 2  # around the hollow, where the inside's surface lies


@dataclass(frozen=True, eq=False)
class Vessel:
    """A vessel.

    Attributes:
        hull: voxels of the visual hull without the hollow.
        hollow: (X, Y, Z) bool, voxels of the hollow.
        depth: (X, Y, Z) distance to the outer surface, the mouth apart, world units.
        thickness: of the wall, world units.
        mouth: (M,) bool, points drawn on the hull that close the mouth.
        closing: (K, 3) these points, world.
        radius: of the bound, world units.
    """

    hull: VisualHull
    hollow: np.ndarray
    depth: np.ndarray
    thickness: float
    mouth: np.ndarray
    closing: np.ndarray
    radius: float

    def surface(self, count: int, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray, float]:
        """Draw points on the surface of the vessel's inside.

        Args:
            count: number of points on the whole hull.
            rng: random generator of the points.

        Returns:
            The K of them that lie on the inside, (K, 3); their normals (K, 3), which face the hollow; and the whole hull's area.
        """
        points, _, area = self.hull.sample(count, rng)
        points = points[self.is_near(points) & (self._at(self.depth, points) > 0.5 * self.thickness)]
        return points, self._inward(points), area

    def is_near(self, points: np.ndarray) -> np.ndarray:
        """Return (N,) True for points (N, 3) in the hollow or at most REACH_VOXELS from it."""
        near = np.asarray(binary_dilation(self.hollow, iterations=REACH_VOXELS), bool)
        return self._at(near.astype(np.float32), points) > 0.5

    def is_in_hollow(self, points: np.ndarray, reach: float) -> np.ndarray:
        """Return (N,) True for points (N, 3) in front of the inside's surface, or at most `reach` from those that close its mouth."""
        inner = self._at(np.where(self.hollow, self.depth, 0), points) > self.thickness + MARGIN * self.radius
        near = KDTree(self.closing).query(points, distance_upper_bound=reach, workers=-1)[0] <= reach
        return inner | (near & (self._at(self.depth, points) > self.thickness))

    def faces_wall(self, points: np.ndarray, normals: np.ndarray) -> np.ndarray:
        """Return (N,) True for points (N, 3) behind the outside whose normals (N, 3) face the wall that is nearest.

        They are stereo's points of the outside that lie too deep, and false ones: no view looks at the inside from there.
        """
        behind = self.is_near(points) & (self._at(self.depth, points) > 0.5 * self.thickness)
        return behind & ((self._inward(points) * normals).sum(1) < 0)

    def _at(self, values: np.ndarray, points: np.ndarray) -> np.ndarray:
        """Return values of the voxels (X, Y, Z) at points (N, 3), interpolated."""
        return map_coordinates(values, ((points - self.hull.corner) / self.hull.step).T, order=1, mode="nearest")

    def _inward(self, points: np.ndarray) -> np.ndarray:
        """Return the directions (N, 3) in which the depth grows at points (N, 3), unit."""
        slope = np.gradient(gaussian_filter(self.depth, NORMAL_BLUR_VOXELS))
        direction = np.stack([self._at(one, points) for one in slope], -1)
        return direction / np.maximum(np.linalg.norm(direction, axis=1, keepdims=True), 1e-12)


def find_vessel(
    hull: VisualHull,
    surface: tuple[np.ndarray, np.ndarray],
    maps: Sequence[DepthMap],
    hull_depth: Sequence[np.ndarray],
    radius: float,
    least_depth: float = MIN_RELATIVE_DEPTH,
) -> Vessel | None:
    """Find the mouths of a vessel, and the thickness of its wall at which stereo's guesses lie nearest to the inside.

    Args:
        hull: voxels of the visual hull.
        surface: points (M, 3) and normals (M, 3) drawn on it.
        maps: depth maps of stereo.
        hull_depth: (H, W) depth of the hull in the same views.
        radius: of the bound, world units.
        least_depth: relative depth from which a part of the hull is a mouth.

    Returns:
        The vessel; None where no part of the hull is a mouth.
    """
    points, _ = surface
    probed = maps[::PROBED_VIEWS], hull_depth[::PROBED_VIEWS]
    mouth = np.zeros(len(points), bool)
    for one in vessel_mouths(*surface, maps, hull_depth, radius):
        vessel = _vessel(hull, points, one, _depth_behind_outside(hull, points, one), THICKNESSES[0], radius)
        if vessel is not None and _relative_depth(vessel, *probed) >= least_depth:
            mouth |= one
    if not mouth.any():
        return None
    measured = _depth_behind_outside(hull, points, mouth)
    vessels = [one for thickness in THICKNESSES if (one := _vessel(hull, points, mouth, measured, thickness, radius)) is not None]
    depths = {one: _relative_depth(one, *probed) for one in vessels}
    if max(depths.values()) < MIN_TELLING_DEPTH:
        return min(vessels, key=lambda one: abs(one.thickness - UNKNOWN_THICKNESS * radius))
    return min(vessels, key=lambda one: abs(depths[one] - 1))


def _vessel(
    hull: VisualHull, points: np.ndarray, mouth: np.ndarray, measured: tuple[np.ndarray, np.ndarray], thickness: float, radius: float
) -> Vessel | None:
    """Return the vessel with a mouth and a thickness in radii of the bound; None where no hollow is left behind the mouth.

    Args:
        hull: voxels of the visual hull.
        points: (M, 3) of its surface.
        mouth: (M,) True for those that close the mouth.
        measured: depths and voxels at the mouth, of `_depth_behind_outside`.
        thickness: of the wall, radii of the bound.
        radius: of the bound, world units.
    """
    depth, opening = measured
    parts = np.asarray(label((hull.inside > 0.5) & (depth > thickness * radius))[0])  # pyright: ignore[reportIndexIssue]
    reached = np.unique(parts[opening])
    hollow = np.isin(parts, reached[reached > 0])
    if mouth.all() or not hollow.any():
        return None
    emptied = gaussian_filter(np.where(hollow, 0, np.minimum(hull.inside, 1)), BLUR_VOXELS)
    around = np.asarray(binary_dilation(hollow, iterations=REACH_VOXELS), bool)
    inside = np.where(around, np.minimum(hull.inside, emptied), hull.inside).astype(np.float32)
    return Vessel(VisualHull(inside, hull.corner, hull.step), hollow, depth, thickness * radius, mouth, points[mouth], radius)


def _depth_behind_outside(hull: VisualHull, points: np.ndarray, mouth: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Measure how deep each voxel lies behind the hull's surface where that closes no mouth.

    Args:
        hull: voxels of the visual hull.
        points: (M, 3) of its surface.
        mouth: (M,) True for those that close a mouth.

    Returns:
        (X, Y, Z) float32 distances, world units; (X, Y, Z) True for voxels at the mouth.
    """
    solid = np.pad(hull.inside > 0.5, 1)
    cells = np.argwhere(np.asarray(binary_dilation(solid, np.ones((3, 3, 3))), bool) & ~solid)  # just outside, corners included
    closing = mouth[np.asarray(KDTree(points).query(hull.corner + (cells - 1) * hull.step, workers=-1)[1])]
    outside, opening = np.zeros_like(solid), np.zeros_like(solid)
    outside[tuple(cells[~closing].T)], opening[tuple(cells[closing].T)] = True, True
    within = slice(1, -1), slice(1, -1), slice(1, -1)
    distance = np.asarray(distance_transform_edt(~outside)) * hull.step
    return distance[within].astype(np.float32), np.asarray(binary_dilation(opening), bool)[within]


def _relative_depth(vessel: Vessel, maps: Sequence[DepthMap], hull_depth: Sequence[np.ndarray]) -> float:
    """Return how deep stereo's depths lie in the hollow, median: 0 at the mouth, 1 at the inside's surface; 0 where no view shows it."""
    relative = []
    for one, mouth, inside in zip(maps, hull_depth, vessel.hull.entries([one.camera for one in maps]), strict=True):
        shown = (inside > mouth + MIN_HOLLOW_DEPTH * vessel.radius) & (mouth > 0) & (one.depth > 0)
        relative.append((one.depth[shown] - mouth[shown]) / (inside[shown] - mouth[shown]))
    found = np.concatenate(relative)
    return float(np.median(found)) if len(found) else 0.0
