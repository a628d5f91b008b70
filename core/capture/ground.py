# SPDX-License-Identifier: GPL-3.0-or-later
"""Ground of a capture: the support plane, without a thin flat part of the object that lies on it.

A plate, a saucer or a disc is lower than the noise of single points of stereo. It lies so near to the plane that all photographs agree
about its colours there, as they do about the table's. It is found by the heights of its points, averaged in cells of the plane: their noise
is a twentieth of a pixel.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy import ndimage

from ..scene.dataset import Bound
from .dense_points import DensePoints
from .object_region import ObjectRegion, bounding_sphere, lowest_height
from .plane_texture import PlaneTexture
from .support_plane import SupportPlane

CELL_PIXELS = 2.0  # side of a cell, pixels (see DensePoints.pixel)
GROUND_REACH = 2.0  # radii of the object around it in which heights are averaged
PLANE_RADIUS = 1.2  # radii from which the heights are those of the plane
MAX_HEIGHT_RATIO = 1.25  # largest height of averaged points, as a factor of the height from which points do not belong to the plane
# Least height of a base over the plane: in pixels, and in standard deviations of the plane's averaged heights.
MIN_BASE_PIXELS, MIN_BASE_DEVIATIONS = 0.6, 8.0
# Largest height of the voxels above a base that show where a thing stands, as a factor of the height from which points do not belong to the
# plane.
FOOT = 4.0
# Height from which a point beside the object may be a foot's, as a fraction of the height from which points do not belong to the plane.
LOWEST_FOOT = 0.35
FOOT_MARGIN_CELLS = 2  # cells beside the object's foot whose heights its own points raise
MIN_BASE_FRACTION = 0.1  # least number of a base's cells beyond these, as a fraction of the foot's
MIN_POINTS_PER_CELL = 1.0  # averaged number of points in a cell whose height is known
_AROUND_CELL = np.ones((3, 3), bool)


@dataclass(frozen=True, eq=False)
class _Cells:
    """Square cells of the support plane.

    Attributes:
        plane: the support plane.
        corner: (2,) of cell (0, 0), in the plane's axes, world units.
        step: side of a cell, world units.
        side: number N of cells along a side.
    """

    plane: SupportPlane
    corner: np.ndarray
    step: float
    side: int

    def locate(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the cells (..., 2) int64 over or under which points (..., 3) lie, and (...,) False for points beside all cells."""
        cell = np.floor((points @ self.plane.axes().T - self.corner) / self.step).astype(np.int64)
        inside = ((cell >= 0) & (cell < self.side)).all(-1)
        return np.where(inside[..., None], cell, 0), inside

    def distances(self) -> np.ndarray:
        """Return the distances (N, N) of the cells from the middle, world units."""
        middle = (np.arange(self.side) - (self.side - 1) / 2) * self.step
        return np.hypot(middle[:, None], middle)

    def under(self, points: np.ndarray) -> np.ndarray:
        """Return (N, N) True for the cells that one of the points (P, 3) lies over."""
        cell, inside = self.locate(points)
        found = np.zeros((self.side, self.side), bool)
        found[tuple(cell[inside].T)] = True
        return found

    def mean_heights(self, points: np.ndarray, highest: float) -> np.ndarray:
        """Return the mean heights (N, N) of the points (P, 3) no higher than `highest` in each cell and around it, NaN where few are."""
        height = self.plane.height(points)
        cell, inside = self.locate(points)
        kept = inside & (np.abs(height) <= highest)
        total, count = np.zeros((2, self.side, self.side))
        np.add.at(total, tuple(cell[kept].T), height[kept])
        np.add.at(count, tuple(cell[kept].T), 1)
        total, count = ndimage.gaussian_filter(total, 1.0), ndimage.gaussian_filter(count, 1.0)
        return np.where(count >= MIN_POINTS_PER_CELL, total / np.maximum(count, MIN_POINTS_PER_CELL), np.nan)


@dataclass(frozen=True, eq=False)
class Base:
    """Thin flat part of the object on the support plane.

    Attributes:
        cells: square cells of the plane.
        covered: (N, N) True where it lies.
        height: height of its upper side over the plane's points around the object, world units.
    """

    cells: _Cells
    covered: np.ndarray
    height: float

    def covers(self, points: np.ndarray) -> np.ndarray:
        """Return (...,) True for the points (..., 3) over or under it."""
        cell, inside = self.cells.locate(points)
        return inside & self.covered[cell[..., 0], cell[..., 1]]


@dataclass(frozen=True, eq=False)
class Ground:
    """Support plane with a base that does not belong to it.

    Attributes:
        plane: the support plane.
        lowest: height above it, world units, from which points do not belong to it.
        base: thin part of the object on it, None where there is none.
    """

    plane: SupportPlane
    lowest: float
    base: Base | None

    def below(self, points: np.ndarray) -> np.ndarray:
        """Return (...,) True for the points (..., 3) that belong to the plane."""
        lowest = self.lowest if self.base is None else np.where(self.base.covers(points), self.base.height / 2, self.lowest)
        return self.plane.height(points) <= lowest

    def may_be_foot(self, points: np.ndarray) -> np.ndarray:
        """Return (...,) True for the points (..., 3) that are lower than those that do not belong to the plane, but hardly in it."""
        return self.below(points) & (self.plane.height(points) > LOWEST_FOOT * self.lowest)

    def visible(self, texture: PlaneTexture) -> PlaneTexture:
        """Return the plane's texture without what the base covers."""
        if self.base is None:
            return texture
        return replace(texture, known=np.where(self.base.covers(texture.points()), np.float32(0), texture.known))


def find_ground(dense: DensePoints, plane: SupportPlane, region: ObjectRegion) -> Ground:
    """Find a thin flat part of the object on the support plane by averaged heights.

    It belongs to the object if it lies under the object's foot and beyond it, and carries nothing else: a mat under several things belongs
    to the table.

    Args:
        dense: dense points.
        plane: plane on which the object stands.
        region: region of the object, from what is clearly above the plane.
    """
    lowest, step, reach = lowest_height(dense, plane), CELL_PIXELS * dense.pixel, GROUND_REACH * region.bound.radius
    cells = _Cells(plane, plane.axes() @ np.asarray(region.bound.centre) - reach, step, int(np.ceil(2 * reach / step)))
    height = cells.mean_heights(dense.points.position, MAX_HEIGHT_RATIO * lowest)
    beside = height[(cells.distances() > PLANE_RADIUS * region.bound.radius) & np.isfinite(height)]
    if not len(beside):
        return Ground(plane, lowest, None)
    level = float(np.median(beside))
    least = max(MIN_BASE_PIXELS * dense.pixel, MIN_BASE_DEVIATIONS * 1.4826 * float(np.median(np.abs(beside - level))))
    foot, others = (cells.under(_standing(region, label, plane, lowest)) for label in (1, 2))
    return Ground(plane, lowest, _base(cells, np.nan_to_num(height - level), least, foot, others))


def _base(cells: _Cells, height: np.ndarray, least: float, foot: np.ndarray, others: np.ndarray) -> Base | None:
    """Return the base under an object.

    Args:
        cells: square cells of the plane.
        height: (N, N) averaged, over the plane around the object, 0 where it is not known.
        least: least height of a base over the plane, world units.
        foot: (N, N) True where the object stands.
        others: (N, N) True where other things stand.
    """
    raised = height > least
    label = np.asarray(ndimage.label(raised | foot, _AROUND_CELL)[0])  # pyright: ignore[reportIndexIssue]
    base = raised & np.isin(label, np.unique(label[foot]))
    beyond = base & ~np.asarray(ndimage.binary_dilation(foot, _AROUND_CELL, FOOT_MARGIN_CELLS), bool)
    beyond = np.asarray(ndimage.binary_opening(beyond, _AROUND_CELL), bool)
    if beyond.sum() <= MIN_BASE_FRACTION * foot.sum():
        return None
    thickness = float(np.median(height[beyond]))
    base &= height > thickness / 2
    ends = np.asarray(ndimage.binary_dilation(others, _AROUND_CELL, FOOT_MARGIN_CELLS), bool)
    ends[[0, -1]] = ends[:, [0, -1]] = True
    if (base & ends).any():
        return None
    return Base(cells, np.asarray(ndimage.binary_fill_holes(base | foot), bool), thickness)


def _standing(region: ObjectRegion, label: int, plane: SupportPlane, lowest: float) -> np.ndarray:
    """Return the centres (P, 3) of the voxels of a label that are higher than a base, but not much."""
    points = region.corner + (np.argwhere(region.label == label) + 0.5) * region.step
    height = plane.height(points)
    return points[(height > MAX_HEIGHT_RATIO * lowest + region.step / 2) & (height <= FOOT * lowest)]


def with_base(region: ObjectRegion, dense: DensePoints, ground: Ground, sphere: Bound | None) -> ObjectRegion:
    """Return the region with the points of the base, if there is one.

    If the user gave a sphere, only points in it are added, and it stays the region's bound.
    """
    if ground.base is None:
        return region
    points = dense.points.position
    if sphere is not None:
        points = points[np.linalg.norm(points - np.asarray(sphere.centre), axis=1) < sphere.radius]
    points = points[ground.base.covers(points) & ~ground.below(points) & (ground.plane.height(points) <= MAX_HEIGHT_RATIO * ground.lowest)]
    cell = np.floor((points - region.corner) / region.step).astype(np.int64)
    cell = cell[((cell >= 0) & (cell < region.label.shape)).all(1)]
    label = region.label.copy()
    label[tuple(cell.T)] = 1
    whole = replace(region, label=label)
    if sphere is not None:
        return whole
    return replace(whole, bound=bounding_sphere(np.concatenate([whole.points(), region.foot]), region.step))
