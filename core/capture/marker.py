# SPDX-License-Identifier: GPL-3.0-or-later
"""True size from a square fiducial marker of known side, triangulated over all photographs that show it."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable
from dataclasses import dataclass
from itertools import combinations

import cv2
import numpy as np
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

from ..scene.camera import GL_TO_CV
from .marker_detection import Detection, detect_markers
from .photograph import Photograph
from .sparse_model import PosedPhotograph, SparseModel

Read = Callable[[Photograph], np.ndarray]  # returns the upright copy, (H, W, 3) uint8 sRGB or (H, W) grey
MIN_PHOTOGRAPHS = 3  # photographs that must agree on a marker
MAX_ERROR = 0.004  # reprojection error of a corner up to which a photograph agrees, in focal lengths
MAX_PAIRS = 200  # pairs of photographs from which a marker is triangulated, at most
MAX_SKEW = 0.1  # deviation of a triangulated marker from a square, in sides
MIN_ANGLE = 2.0  # degrees between the rays of a pair of photographs to a marker
SQUARE = np.array([[-0.5, 0.5, 0], [0.5, 0.5, 0], [0.5, -0.5, 0], [-0.5, -0.5, 0]])  # OpenCV's corner order, normal +Z


@dataclass(frozen=True, eq=False)
class MarkerScale:
    """Marker that photographs show, and the scale of the sparse model that follows.

    Attributes:
        name: dictionary and id, for the user.
        metres_per_unit: metres in a unit of the model's frame.
        photographs: number of photographs that agree.
        error: median reprojection error of the corners, pixels.
    """

    name: str
    metres_per_unit: float
    photographs: int
    error: float


@dataclass(frozen=True, eq=False)
class _View:
    """Marker in one photograph.

    Attributes:
        rotation, translation: (3, 3) and (3,) from the model to the camera, OpenCV's axes.
        corners: (4, 2) undistorted normalised coordinates.
        focal: pixels.
    """

    rotation: np.ndarray
    translation: np.ndarray
    corners: np.ndarray
    focal: float

    @property
    def centre(self) -> np.ndarray:
        """Centre of the camera (3,)."""
        return -self.rotation.T @ self.translation

    def project(self, points: np.ndarray) -> np.ndarray:
        """Return the normalised coordinates (N, 2) of points (N, 3); far away for points behind the camera."""
        x = points @ self.rotation.T + self.translation
        return np.where(x[:, 2:] > 1e-9, x[:, :2] / np.maximum(x[:, 2:], 1e-9), 1e3)

    def agrees(self, points: np.ndarray) -> bool:
        """Return True if all corners (4, 3) project to where they were found."""
        return bool((np.linalg.norm(self.project(points) - self.corners, axis=1) < MAX_ERROR).all())


def find_marker_scale(model: SparseModel, side: float, read: Read) -> MarkerScale | None:
    """Find the marker on which most photographs agree, and the model's scale from its side.

    A marker that a dictionary finds in the texture by chance is in few photographs, or at no common place.

    Args:
        model: cameras of the photographs.
        side: side of the marker's black square, metres.
        read: returns the pixels of a photograph's upright copy, (H, W, 3) or (H, W) uint8.

    Returns:
        The marker; None if no three photographs agree on one.
    """
    views: dict[tuple[str, int], list[_View]] = defaultdict(list)
    for posed in model.posed:
        grey = read(posed.photograph)
        grey = cv2.cvtColor(grey, cv2.COLOR_RGB2GRAY) if grey.ndim == 3 else grey
        for one in detect_markers(np.ascontiguousarray(grey)):
            views[one.dictionary, one.number].append(_view(posed, one))
    fits = [(key, fit) for key, seen in sorted(views.items()) if len(seen) >= MIN_PHOTOGRAPHS and (fit := _fit_marker(seen)) is not None]
    if not fits:
        return None
    (name, number), (corners, agreeing) = max(fits, key=lambda f: len(f[1][1]))
    error = np.concatenate([v.focal * np.linalg.norm(v.project(corners) - v.corners, axis=1) for v in agreeing])
    length = np.linalg.norm(corners - np.roll(corners, 1, 0), axis=1).mean()
    shown = f"{name.removeprefix('DICT_').removesuffix('_1000')} id {number}"
    return MarkerScale(shown, side / float(length), len(agreeing), float(np.median(error)))


def _view(posed: PosedPhotograph, found: Detection) -> _View:
    lens, to_camera = posed.lens, GL_TO_CV @ np.linalg.inv(posed.to_world)
    matrix = np.array([[lens.fx, 0, lens.cx], [0, lens.fy, lens.cy], [0, 0, 1.0]])
    coefficients = np.array(lens.distortion or (0.0,) * 5)
    stop = (cv2.TERM_CRITERIA_EPS + cv2.TERM_CRITERIA_MAX_ITER, 50, 1e-10)
    rays = cv2.undistortPointsIter(found.corners.reshape(-1, 1, 2), matrix, coefficients, np.eye(3), np.eye(3), stop)
    return _View(to_camera[:3, :3], to_camera[:3, 3], rays.reshape(4, 2), float(np.sqrt(lens.fx * lens.fy)))


def _fit_marker(views: list[_View]) -> tuple[np.ndarray, list[_View]] | None:
    """Triangulate the corners from pairs of views, keep what most agree on, and fit a square; None if fewer than MIN_PHOTOGRAPHS agree."""
    pairs = list(combinations(range(len(views)), 2))
    best: tuple[np.ndarray, list[_View]] | None = None
    for i, j in pairs[:: max(1, len(pairs) // MAX_PAIRS)]:
        corners = _triangulate(views[i], views[j])
        if corners is None:
            continue
        agreeing = [v for v in views if v.agrees(corners)]
        if len(agreeing) >= MIN_PHOTOGRAPHS and (best is None or len(agreeing) > len(best[1])):
            best = corners, agreeing
    if best is None or _skew(best[0]) > MAX_SKEW:
        return None
    square = _fit_square(*best)
    agreeing = [v for v in views if v.agrees(square)]
    return (square, agreeing) if len(agreeing) >= MIN_PHOTOGRAPHS else None


def _triangulate(one: _View, other: _View) -> np.ndarray | None:
    """Return the corners (4, 3) where the rays of two views meet; None if the rays are nearly parallel."""
    first, second = (np.hstack([v.rotation, v.translation[:, None]]) for v in (one, other))
    points = cv2.triangulatePoints(first, second, np.ascontiguousarray(one.corners.T), np.ascontiguousarray(other.corners.T))
    if (np.abs(points[3]) < 1e-12).any():
        return None
    corners = (points[:3] / points[3]).T
    rays = [corners.mean(0) - v.centre for v in (one, other)]
    cosine = rays[0] @ rays[1] / max(np.linalg.norm(rays[0]) * np.linalg.norm(rays[1]), 1e-30)
    return corners if cosine < np.cos(np.radians(MIN_ANGLE)) else None


def _skew(corners: np.ndarray) -> float:
    """Return how far four corners (4, 3) are from a square, in sides: unequal sides or diagonals, or not in a plane."""
    sides = np.linalg.norm(corners - np.roll(corners, 1, 0), axis=1)
    diagonals = np.linalg.norm(corners[:2] - corners[2:], axis=1)
    bent = np.linalg.norm(corners[0] - corners[1] + corners[2] - corners[3])
    return float(max(np.ptp(sides), np.ptp(diagonals), bent) / sides.mean())


def _fit_square(corners: np.ndarray, views: list[_View]) -> np.ndarray:
    """Fit a square to all views by their reprojection errors with a robust loss; return its corners (4, 3)."""
    centre, across, up = corners.mean(0), corners[1] - corners[0], corners[0] - corners[3]
    normal = np.cross(across, up)
    up = np.cross(normal, across)
    axes = np.stack([v / np.linalg.norm(v) for v in (across, up, normal)], -1)
    size = np.linalg.norm(corners - np.roll(corners, 1, 0), axis=1).mean()

    def square(x: np.ndarray) -> np.ndarray:
        turn = Rotation.from_rotvec(x[:3]).as_matrix() @ axes
        return centre + size * x[3:6] + size * np.exp(x[6]) * SQUARE @ turn.T

    def residuals(x: np.ndarray) -> np.ndarray:
        place = square(x)
        return np.concatenate([(v.focal * (v.project(place) - v.corners)).ravel() for v in views])

    return square(least_squares(residuals, np.zeros(7), loss="soft_l1", f_scale=0.5).x)
