# SPDX-License-Identifier: GPL-3.0-or-later
"""Object's region in space: the cluster of dense points that the cameras look at, told from the plane, clutter and background."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from scipy import ndimage
from scipy.spatial import KDTree

from ..datasets.bound import bound_of_cameras
from ..scene.camera import Camera
from ..scene.dataset import Bound
from ..scene.unique_rows import unique_rows
from .dense_points import DensePoints
from .soft_hull import projected_voxels
from .support_plane import SupportPlane

VOXEL_PIXELS = 2.5  # side of a voxel, pixels of a depth map at the look-at point's distance
NEAR_VOXELS = 2  # voxels beside the object in which points low above the plane may be its feet
SEARCH_REACH = 0.85  # distances of the cameras around the look-at point in which clusters are sought
FRAME_RADII = 2.0  # reach of that search in radii of the sphere that fills the images; the shorter of both reaches counts
# Height above the plane from which points do not belong to it, in pixels of a depth map at the look-at point's distance.
MIN_HEIGHT_PIXELS = 2.0
MIN_HEIGHT_DEVIATIONS = 4.0  # that height in standard deviations of the plane's points; the larger of both heights counts
MIN_POINTS_PER_VOXEL = 3  # points in a voxel from which it is occupied
MIN_CLUSTER_VOXELS = 12  # voxels of a cluster
MAX_GAP_RADII = 0.12  # radii of the object to a part that hangs free, up to which it belongs to the object
STANDING_VOXELS = 4.0  # voxels above the plane below which a cluster stands on it by itself
FOOT_FRACTION = 0.25  # lowest part of the object's height; between it and the plane may be a foot that stereo does not see
CLUTTER_RADII = 3.0  # radii of the object up to which other things are near it
CENTRAL_FRACTION = 0.5  # of half the image's shorter side, where a cluster's centrality has fallen to 0.6
RADIUS_QUANTILE = 0.995  # of the points' distances from the centre that the radius covers
RADIUS_MARGIN = 1.1  # factor of that radius
SMALL, INSET = 48, 5  # side of the small images in which the borders are looked at, and width of the rim that stereo sees badly, pixels
MAX_BORDER_FRACTION = 0.5  # largest mean fraction of the images' borders that an object on a plane covers
MAX_HANGING_BORDER_FRACTION = 0.3  # largest such fraction without a plane: only free space around it tells an object from a facade then
MIN_FRAMED_FRACTION = 0.6  # mean fraction of the object's points inside the images below which it is no object but the scene


@dataclass(frozen=True, eq=False)
class ObjectRegion:
    """Voxels around the object's points.

    Attributes:
        bound: bounding sphere, robust against single points.
        corner: (3,) corner of voxel (0, 0, 0).
        step: side of a voxel, world units.
        label: (X, Y, Z) uint8: 1 the object, 2 other things above the plane, 0 no points.
        clutter: bounding spheres of other things near the object, the largest first.
        foot: (F, 3) points between the object and the plane where a foot may be, see `unseen_foot`.
    """

    bound: Bound
    corner: np.ndarray
    step: float
    label: np.ndarray
    clutter: list[Bound]
    foot: np.ndarray = field(default_factory=lambda: np.empty((0, 3)))

    def labels(self, points: np.ndarray) -> np.ndarray:
        """Return the labels (...,) of points (..., 3), 0 outside the voxels."""
        return _looked_up(self.label, (points - self.corner) / self.step)

    def near(self, points: np.ndarray) -> np.ndarray:
        """Return (...,) True for the points (..., 3) that are no more than NEAR_VOXELS voxels beside those of the object."""
        return _looked_up(self._widened, (points - self.corner) / self.step + NEAR_VOXELS)

    @cached_property
    def _widened(self) -> np.ndarray:
        """Voxels (X + 2 NEAR_VOXELS, ...) bool in and near the object."""
        return np.asarray(ndimage.binary_dilation(np.pad(self.label == 1, NEAR_VOXELS), np.ones((3, 3, 3)), NEAR_VOXELS), bool)

    def points(self) -> np.ndarray:
        """Return the centres (N, 3) of the object's voxels."""
        return self.corner + (np.argwhere(self.label == 1) + 0.5) * self.step


def _looked_up(grid: np.ndarray, place: np.ndarray) -> np.ndarray:
    """Return the values (...,) of a grid (X, Y, Z) at places (..., 3) in voxels, 0 outside."""
    cell = np.floor(place).astype(np.int64)
    inside = ((cell >= 0) & (cell < grid.shape)).all(-1)
    cell = np.where(inside[..., None], cell, 0)
    return np.where(inside, grid[cell[..., 0], cell[..., 1], cell[..., 2]], grid.dtype.type(0))


@dataclass(frozen=True, eq=False)
class _Clusters:
    """Connected voxels.

    Attributes:
        cells: (N, 3) occupied voxels.
        label: (N,) cluster of each, from 0.
        centre: (C, 3) mean of each cluster, world.
        size: (C,) voxels of each cluster.
        floor: (C,) least height above the plane, world units; 0 without a plane.
    """

    cells: np.ndarray
    label: np.ndarray
    centre: np.ndarray
    size: np.ndarray
    floor: np.ndarray


def find_object_region(
    dense: DensePoints, plane: SupportPlane | None, cameras: Sequence[Camera], sphere: Bound | None = None
) -> ObjectRegion | None:
    """Find the cluster of points above the plane that the cameras look at.

    Points above the plane are joined in voxels and labelled by connectivity. The object is the cluster that is largest and most central in
    the images; parts that hang free right beside it belong to it, and what lies under it where it does not reach the plane. If the user
    gave a sphere, everything above the plane in it does.

    Args:
        dense: dense points.
        plane: plane on which the object stands, or None.
        cameras: cameras of all views.
        sphere: bounding sphere of the object, if the user gave it.

    Returns:
        The region, None where there is no cluster or where it fills the images beyond their edges, as a facade does.
    """
    reach = _reach(dense, cameras, sphere)
    points = _above(dense, plane, reach)
    step = VOXEL_PIXELS * dense.pixel
    corner = dense.target - reach - step
    shape = np.full(3, int(np.ceil(2 * (reach + step) / step)))
    cells = np.floor((points - corner) / step).astype(np.int64)
    flat, count = np.unique(np.ravel_multi_index(tuple(cells.T), tuple(shape)), return_counts=True)
    occupied = np.zeros(shape, bool)
    occupied.reshape(-1)[flat[count >= MIN_POINTS_PER_VOXEL]] = True
    clusters = _clusters(occupied, corner, step, plane)
    if clusters is None:
        return None
    own = _looked_at(clusters, corner, step, plane, cameras) if sphere is None else _inside(clusters, corner, step, sphere)
    if own is None:
        return None
    label = _labelled(clusters, own, shape, corner, step, sphere)
    own_points = corner + (np.argwhere(label == 1) + 0.5) * step
    foot = own_points[:0] if plane is None else unseen_foot(own_points, plane, step)
    bound = sphere or bounding_sphere(np.concatenate([own_points, foot]), step)
    region = ObjectRegion(bound, corner, step, label, _clutter(clusters, own, corner, step, bound), foot)
    return (
        region
        if sphere is not None or _framed(region, cameras, MAX_HANGING_BORDER_FRACTION if plane is None else MAX_BORDER_FRACTION)
        else None
    )


def _labelled(clusters: _Clusters, own: np.ndarray, shape: np.ndarray, corner: np.ndarray, step: float, sphere: Bound | None) -> np.ndarray:
    """Return the labels (X, Y, Z) uint8 of `ObjectRegion`: by cluster, or by the user's sphere."""
    label = np.zeros(shape, np.uint8)
    inside = own[clusters.label]
    if sphere is not None:
        inside = np.linalg.norm(corner + (clusters.cells + 0.5) * step - sphere.centre, axis=1) < sphere.radius
    label[tuple(clusters.cells.T)] = np.where(inside, 1, 2)
    return label


def _reach(dense: DensePoints, cameras: Sequence[Camera], sphere: Bound | None) -> float:
    """Return the distance from the look-at point up to which clusters are sought."""
    nearer = SEARCH_REACH * dense.distance
    if sphere is None:
        return min(nearer, FRAME_RADII * bound_of_cameras(cameras).radius)
    return max(min(nearer, CLUTTER_RADII * sphere.radius), sphere.radius)


def _above(dense: DensePoints, plane: SupportPlane | None, reach: float) -> np.ndarray:
    """Return the points (N, 3) float64 around the look-at point and above the plane."""
    position = dense.points.position
    position = position[np.linalg.norm(position - dense.target, axis=1) < reach].astype(np.float64)
    return position if plane is None else position[plane.height(position) > lowest_height(dense, plane)]


def lowest_height(dense: DensePoints, plane: SupportPlane) -> float:
    """Return the height above the plane, world units, from which points do not belong to it."""
    return max(MIN_HEIGHT_PIXELS * dense.pixel, MIN_HEIGHT_DEVIATIONS * plane.noise)


def _clusters(occupied: np.ndarray, corner: np.ndarray, step: float, plane: SupportPlane | None) -> _Clusters | None:
    """Label connected voxels, and drop the smallest clusters; None where no cluster is left."""
    label = np.zeros(occupied.shape, np.int32)
    count = int(ndimage.label(occupied, np.ones((3, 3, 3)), output=label))  # pyright: ignore[reportArgumentType]
    cells = np.argwhere(occupied)
    own = label[tuple(cells.T)] - 1
    size = np.bincount(own, minlength=count)
    keep = size >= MIN_CLUSTER_VOXELS
    if not keep.any():
        return None
    number = np.cumsum(keep) - 1
    cells, own = cells[keep[own]], number[own[keep[own]]]
    centres = corner + (cells + 0.5) * step
    mean = np.stack([np.bincount(own, c) for c in centres.T], 1) / size[keep][:, None]
    floor = np.zeros(len(mean))
    if plane is not None:
        floor[:] = np.inf
        np.minimum.at(floor, own, plane.height(centres))
    return _Clusters(cells, own, mean, size[keep], floor)


def _looked_at(clusters: _Clusters, corner: np.ndarray, step: float, plane: SupportPlane | None, cameras: Sequence[Camera]) -> np.ndarray:
    """Return (C,) True for the cluster that is largest and most central in the images, and for its parts.

    Parts hang free beside it, or lie under it where it does not reach the plane itself: something must carry it, and of a foot in the dark
    stereo sees only pieces.
    """
    central = np.mean([_centrality(camera, clusters.centre) for camera in cameras], 0)
    first = int(np.argmax(central**2 * np.sqrt(clusters.size)))
    own = np.zeros(len(clusters.size), bool)
    own[first] = True
    bound = bounding_sphere(corner + (clusters.cells[clusters.label == first] + 0.5) * step, step)
    standing = clusters.floor < STANDING_VOXELS * step
    if plane is not None and not standing[first]:
        own |= _beneath(clusters, first, corner, step, plane)
    own |= (_distances(clusters, own, step) < max(MAX_GAP_RADII * bound.radius, 3 * step)) & ~standing
    return own


def _beneath(clusters: _Clusters, first: int, corner: np.ndarray, step: float, plane: SupportPlane) -> np.ndarray:
    """Return (C,) True for the clusters at least half of which lies between one of them and the plane."""
    centres = corner + (clusters.cells + 0.5) * step
    flat, body = centres @ plane.axes().T, clusters.label == first
    over = KDTree(flat[body]).query(flat)[0] <= step
    lower = clusters.floor < clusters.floor[first]
    return lower & (np.bincount(clusters.label, over) >= 0.5 * clusters.size)


def unseen_foot(points: np.ndarray, plane: SupportPlane, step: float) -> np.ndarray:
    """Return where the foot of an object may be that does not reach its plane, because stereo sees nothing of the foot in the dark.

    Args:
        points: (N, 3) centres of the object's voxels, at least one.
        plane: plane on which it stands.
        step: side of a voxel, world units.

    Returns:
        (F, 3) points a voxel apart, between the lowest FOOT_FRACTION of the object and the plane; none where it reaches the plane.
    """
    height = plane.height(points)
    lowest = float(height.min())
    if lowest < STANDING_VOXELS * step:
        return points[:0]
    lower = height < lowest + FOOT_FRACTION * (float(height.max()) - lowest)
    down = step * np.arange(1, int(height[lower].max() / step) + 1)
    columns = points[lower][:, None] - down[:, None] * plane.normal
    return unique_rows(np.round(columns[down < height[lower][:, None]] / step)) * step


def _distances(clusters: _Clusters, own: np.ndarray, step: float) -> np.ndarray:
    """Return (C,) least distance of each cluster to some of them, (C,) bool, world units."""
    distance = KDTree(clusters.cells[own[clusters.label]]).query(clusters.cells)[0] * step
    least = np.full(len(clusters.size), np.inf)
    np.minimum.at(least, clusters.label, distance)
    return least


def _centrality(camera: Camera, points: np.ndarray) -> np.ndarray:
    """Return (N,) in 0..1, how near to the image's centre points are: 1 in the centre, 0 outside."""
    pixel, depth = camera.project(points)
    off = np.linalg.norm(pixel - (camera.width / 2, camera.height / 2), axis=1) / (CENTRAL_FRACTION * min(camera.width, camera.height) / 2)
    return np.where(camera.in_image(pixel, depth), np.exp(-0.5 * np.minimum(off, 40) ** 2), 0)


def _inside(clusters: _Clusters, corner: np.ndarray, step: float, sphere: Bound) -> np.ndarray | None:
    """Return (C,) True for the clusters that lie at least half in a sphere; None where no voxel does."""
    inside = np.linalg.norm(corner + (clusters.cells + 0.5) * step - sphere.centre, axis=1) < sphere.radius
    if not inside.any():
        return None
    return np.bincount(clusters.label, inside) >= 0.5 * clusters.size


def bounding_sphere(points: np.ndarray, step: float) -> Bound:
    """Return a sphere about the centres (N, 3) of voxels with a side `step` that leaves out the farthest few."""
    low, high = np.quantile(points, [1 - RADIUS_QUANTILE, RADIUS_QUANTILE], axis=0)
    x, y, z = (float(c) for c in (low + high) / 2)
    far = np.quantile(np.linalg.norm(points - (x, y, z), axis=1), RADIUS_QUANTILE)
    return Bound((x, y, z), RADIUS_MARGIN * float(far) + step)


def _clutter(clusters: _Clusters, own: np.ndarray, corner: np.ndarray, step: float, bound: Bound) -> list[Bound]:
    """Return the bounding spheres of other clusters near the object, the largest first."""
    near = np.linalg.norm(clusters.centre - bound.centre, axis=1) < CLUTTER_RADII * bound.radius
    numbers = np.flatnonzero(near & ~own & (clusters.size >= 4 * MIN_CLUSTER_VOXELS))
    numbers = numbers[np.argsort(-clusters.size[numbers], kind="stable")]
    return [bounding_sphere(corner + (clusters.cells[clusters.label == n] + 0.5) * step, step) for n in numbers]


def _framed(region: ObjectRegion, cameras: Sequence[Camera], most: float) -> bool:
    """Return True where the images show most of the object, and it covers at most a fraction of their borders."""
    points = region.points()
    shown, border = [], []
    for camera in cameras:
        shown.append(float(camera.in_image(*camera.project(points)).mean()))
        image = projected_voxels(camera.resized(SMALL, SMALL), points, region.step)[INSET:-INSET, INSET:-INSET]
        border.append(float(np.concatenate([image[0], image[-1], image[:, 0], image[:, -1]]).mean()))
    return float(np.mean(shown)) > MIN_FRAMED_FRACTION and float(np.mean(border)) < most
