# SPDX-License-Identifier: GPL-3.0-or-later
"""Support plane: the table or floor that the object stands on, found by RANSAC on oriented points."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.spatial import ConvexHull, QhullError

from ..scene.camera import Camera
from ..scene.voxel_means import voxel_means
from .dense_points import DensePoints

HYPOTHESES = 400  # planes through one point with its normal
REFINED_HYPOTHESES = 24  # best of them that are fitted to their inliers
FIT_ROUNDS = 4  # fits of each
VOXEL_PIXELS = 2.0  # pixels (see DensePoints.pixel) in which points are averaged, so that near surfaces don't count more than far ones
POINT_REACH = 0.8  # distances of the cameras around the look-at point in which points count
HALF_WEIGHT_DISTANCE = 0.3  # distances of the cameras at which an inlier's weight is a half
INLIER_PIXELS = 1.5  # pixels from the plane up to which a point is an inlier
MIN_NORMAL_COSINE = np.cos(np.radians(25.0))  # of the angle between an inlier's normal and the plane's
MIN_ABOVE_FRACTION = 0.95  # fraction of the cameras that must be on the plane's upper side
WALL_WEIGHT = 0.3  # weight of a wall against that of a table: photographs are held upright
MIN_PLANE_POINTS = 200  # averaged points on a plane
OFF_PLANE_PIXELS = 4.0  # pixels above or below the plane from which a point is not on it
MIN_STANDING_RATIO = 0.02  # points above the plane's middle over its inliers from which something stands on it
MAX_BENEATH_RATIO = 0.5  # points below the plane's middle over those above it from which the plane is a face of the object
# Points right below the plane's extent over those above its middle from which it is no table: cameras can't see through one.
MAX_THROUGH_RATIO = 0.1


@dataclass(frozen=True, eq=False)
class SupportPlane:
    """Plane on which the object stands.

    Attributes:
        normal: (3,) float64 unit normal, on the cameras' side.
        offset: points x of the plane have normal . x = offset.
        noise: robust standard deviation of its points' heights, world units.
        extent: (K, 3) corners of the convex hull of its points, on the plane.
    """

    normal: np.ndarray
    offset: float
    noise: float
    extent: np.ndarray

    def height(self, points: np.ndarray) -> np.ndarray:
        """Return the signed heights (...,) of points (..., 3) above the plane."""
        return points @ self.normal - self.offset

    def axes(self) -> np.ndarray:
        """Return two unit vectors (2, 3) that span the plane."""
        first = np.cross(self.normal, np.eye(3)[np.abs(self.normal).argmin()])
        first /= np.linalg.norm(first)
        return np.stack([first, np.cross(self.normal, first)])

    def over(self, points: np.ndarray) -> np.ndarray:
        """Return (N,) True for the points (N, 3) over or under the extent."""
        axes = self.axes()
        edges = ConvexHull(self.extent @ axes.T).equations  # (K, 3): normals outwards, and offsets
        return (points @ (axes.T @ edges[:, :2].T) + edges[:, 2] <= 0).all(1)


@dataclass(frozen=True, eq=False)
class _Scene:
    """Averaged points (N, 3) with normals (N, 3) and weights (N,), and the inliers' tolerance."""

    position: np.ndarray
    normal: np.ndarray
    weight: np.ndarray
    tolerance: float

    def inliers(self, normal: np.ndarray, offset: float, tolerance: float) -> np.ndarray:
        """Return (N,) True for the points on a plane whose normals agree with it."""
        return (np.abs(self.position @ normal - offset) < tolerance) & (self.normal @ normal > MIN_NORMAL_COSINE)


def find_support_plane(dense: DensePoints, cameras: Sequence[Camera], seed: int) -> SupportPlane | None:
    """Find the plane that something near the look-at point stands on, with the cameras above it.

    Hypotheses are drawn from single oriented points, weighted near the look-at point, and the best are fitted to their inliers by least
    squares (RANSAC with local optimisation; Chum et al. 2003). A plane counts if something stands on its middle and next to nothing lies
    below it, as under a face of the object itself.

    Args:
        dense: dense points.
        cameras: cameras of all views.
        seed: seed of the random selection of hypotheses.

    Returns:
        The plane, or None where there is none.
    """
    scene = _near_points(dense)
    if len(scene.position) < MIN_PLANE_POINTS:
        return None
    centres = np.stack([camera.centre for camera in cameras])
    upright = np.mean([camera.to_world[:3, 1] for camera in cameras], 0)
    upright /= max(float(np.linalg.norm(upright)), 1e-9)
    best, found = 0.0, None
    for normal, offset in _hypotheses(scene, centres, np.random.default_rng([seed, 1])):
        plane = _fitted(scene, normal, offset)
        if plane is None or (centres @ plane[0] - plane[1] > scene.tolerance).mean() < MIN_ABOVE_FRACTION:
            continue
        on = scene.inliers(*plane, scene.tolerance)
        score = scene.weight[on].sum() * (WALL_WEIGHT + (1 - WALL_WEIGHT) * max(float(plane[0] @ upright), 0.0))
        if score > best and (one := _described(scene, *plane, on)) is not None and _carries(scene, one, dense):
            best, found = score, one
    return found


def _near_points(dense: DensePoints) -> _Scene:
    """Average the points around the look-at point in voxels."""
    points = dense.points
    reach = np.linalg.norm(points.position - dense.target, axis=1)
    position, normal = (
        points.position[reach < POINT_REACH * dense.distance].astype(np.float64),
        points.normal[reach < POINT_REACH * dense.distance],
    )
    if not len(position):
        return _Scene(position, normal, np.empty(0), 0.0)
    cells = np.floor((position - position.min(0)) / (VOXEL_PIXELS * dense.pixel)).astype(np.int64)
    (position, normal), _ = voxel_means(cells, (position, normal))
    normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-9)
    weight = 1 / (1 + (np.linalg.norm(position - dense.target, axis=1) / (HALF_WEIGHT_DISTANCE * dense.distance)) ** 2)
    return _Scene(position, normal, weight, INLIER_PIXELS * dense.pixel)


def _hypotheses(scene: _Scene, centres: np.ndarray, rng: np.random.Generator) -> list[tuple[np.ndarray, float]]:
    """Return the best planes (normal, offset) through single points, those with most weight of inliers first."""
    picks = rng.choice(len(scene.position), HYPOTHESES, p=scene.weight / scene.weight.sum())
    some = rng.permutation(len(scene.position))[:8000]
    part = _Scene(scene.position[some], scene.normal[some], scene.weight[some], scene.tolerance)
    ranked = []
    for i in picks:
        normal = scene.normal[i]
        offset = float(scene.position[i] @ normal)
        if (centres @ normal > offset).mean() >= MIN_ABOVE_FRACTION:
            ranked.append((float(part.weight[part.inliers(normal, offset, 3 * scene.tolerance)].sum()), normal, offset))
    ranked.sort(key=lambda one: -one[0])
    return [(normal, offset) for _, normal, offset in ranked[:REFINED_HYPOTHESES]]


def _fitted(scene: _Scene, normal: np.ndarray, offset: float) -> tuple[np.ndarray, float] | None:
    """Fit a plane to its inliers again and again, with a shrinking tolerance; None where too few are left."""
    for tolerance in scene.tolerance * np.linspace(3, 1, FIT_ROUNDS):
        on = scene.inliers(normal, offset, tolerance)
        if on.sum() < MIN_PLANE_POINTS:
            return None
        weight = scene.weight[on] / scene.weight[on].sum()
        centre = weight @ scene.position[on]
        off = scene.position[on] - centre
        fitted = np.linalg.eigh((off * weight[:, None]).T @ off)[1][:, 0]
        normal = fitted if fitted @ normal > 0 else -fitted
        offset = float(centre @ normal)
    return normal, offset


def _described(scene: _Scene, normal: np.ndarray, offset: float, on: np.ndarray) -> SupportPlane | None:
    """Return a plane with the noise and the extent of its inliers; None where they lie on a line."""
    height = scene.position[on] @ normal - offset
    plane = SupportPlane(normal, offset, 1.4826 * float(np.median(np.abs(height))), np.empty((0, 3)))
    flat = scene.position[on] - height[:, None] * normal
    try:
        corners = ConvexHull(flat @ plane.axes().T).vertices
    except QhullError:
        return None
    return SupportPlane(normal, offset, plane.noise, flat[corners])


def _carries(scene: _Scene, plane: SupportPlane, dense: DensePoints) -> bool:
    """Return True where something stands on the plane near the look-at point, and hardly anything lies below it there."""
    near = scene.position[np.linalg.norm(scene.position - dense.target, axis=1) < HALF_WEIGHT_DISTANCE * dense.distance]
    height = plane.height(near)
    above = int(plane.over(near[height > OFF_PLANE_PIXELS * dense.pixel]).sum())
    under = near[height < -OFF_PLANE_PIXELS * dense.pixel]
    on = int((np.abs(height) < scene.tolerance).sum())
    return (
        above > MIN_STANDING_RATIO * on
        and len(under) < MAX_BENEATH_RATIO * above
        and int(plane.over(under).sum()) < MAX_THROUGH_RATIO * above
    )
