# SPDX-License-Identifier: GPL-3.0-or-later
"""Where the object is: the point the cameras look at, the sparse points there, the region inside every mask."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from ..errors import InputError
from ..scene.camera import Camera
from ..scene.dataset import Bound, PointCloud, View
from ..settings.schema import DataSettings
from .parsed_dataset import MINIMUM_VIEWS, ParsedDataset

MARGIN = 1.08
FRAME_MARGIN = 1.5  # an object reaches no further than this beyond the sphere that fills the images
HULL_CELLS = 40  # along a side of the carving grid
HULL_ROUNDS = 3  # each fits the grid to what the last one left
HULL_VIEWS = 32
MASK_PIXELS = 256  # masks are looked at no finer than this
MISSES = 0.05  # part of the views that may contradict a cell: masks are never perfect


@dataclass(frozen=True, eq=False)
class Focus:
    """The point nearest to all viewing axes, the median camera distance to it, and whether the cameras do look at one point."""

    point: np.ndarray
    distance: float
    reliable: bool


def object_bound(capture: ParsedDataset, views: list[View], settings: DataSettings, warnings: list[str]) -> Bound:
    """The given bound, or what masks, points and cameras tell, whichever says most. Raises InputError where the given one is none."""
    bound = capture.bound or _estimated_bound(views, capture.points, warnings)
    centre, radius = bound.centre, bound.radius
    if settings.centre is not None:
        x, y, z = capture.to_world[:3, :3] @ np.array(settings.centre, np.float64) + capture.to_world[:3, 3]
        centre = float(x), float(y), float(z)
    if settings.radius is not None:
        radius = settings.radius * float(np.cbrt(np.linalg.det(capture.to_world[:3, :3])))
    if not np.isfinite((*centre, radius)).all() or radius <= 0:
        raise InputError("data.centre, data.radius", "the object bound is not finite or empty", "give a centre and a positive radius")
    return Bound(centre, radius)


def _estimated_bound(views: list[View], points: PointCloud | None, warnings: list[str]) -> Bound:
    cameras = [v.camera for v in views]
    rough = bound_of_points(cameras, points.position.astype(np.float64)) if points is not None else None
    start = rough or bound_of_cameras(cameras)
    masked = [(v.camera, v.alpha) for v in views if v.alpha is not None]
    if len(masked) >= MINIMUM_VIEWS:
        hull = bound_of_masks([c for c, _ in masked], [a for _, a in masked], start)
        if hull is not None:
            return hull
        warnings.append("no region lies inside all masks: masks and cameras don't fit together; the bound is guessed without them")
    if rough is None and not focus_of(cameras).reliable:
        warnings.append("the cameras don't look at one point: the object bound is a guess; give data.centre and data.radius")
    return start


def focus_of(cameras: Sequence[Camera]) -> Focus:
    """Robust (reweighted) least-squares intersection of the viewing axes; needs two cameras or more."""
    centres = np.stack([c.centre for c in cameras])
    axes = np.stack([c.forward for c in cameras])
    away = np.eye(3) - axes[:, :, None] * axes[:, None, :]  # (N, 3, 3) projection across each axis
    weights = np.ones(len(cameras))
    point = centres.mean(0)
    spread = 0.0
    for _ in range(8):
        normal = (weights[:, None, None] * away).sum(0)
        spread = np.linalg.eigvalsh(normal)[0] / weights.sum()
        point = np.linalg.lstsq(normal, (weights[:, None] * np.einsum("nij,nj->ni", away, centres)).sum(0), rcond=1e-9)[0]
        misses = np.linalg.norm(np.einsum("nij,nj->ni", away, point - centres), axis=-1)
        weights = 1 / np.maximum(misses, 0.25 * np.median(misses) + 1e-12)
        weights /= weights.max()
    ahead = np.einsum("ni,ni->n", point - centres, axes) > 0
    distance = float(np.median(np.linalg.norm(centres - point, axis=-1)))
    # Axes within about two degrees of parallel fix no depth.
    return Focus(point, distance, bool(spread > 1e-3 and ahead.mean() > 0.5))


def bound_of_cameras(cameras: Sequence[Camera]) -> Bound:
    """The sphere about the focus that fills the images."""
    focus = focus_of(cameras)
    half_angles = [np.arctan(min(c.width / c.fx, c.height / c.fy) / 2) for c in cameras]
    return _sphere(focus.point, focus.distance * float(np.sin(np.median(half_angles))), cameras)


def bound_of_points(cameras: Sequence[Camera], points: np.ndarray) -> Bound | None:
    """The sphere about the sparse points (P, 3) near the focus that at least half of the cameras see; None where there are too few."""
    focus = focus_of(cameras)
    seen = np.zeros(len(points))
    for camera in cameras:
        seen += _in_image(camera, *camera.project(points))
    framed = min(FRAME_MARGIN * bound_of_cameras(cameras).radius, 0.8 * focus.distance)
    near = points[(seen >= 0.5 * len(cameras)) & (np.linalg.norm(points - focus.point, axis=-1) < framed)]
    if not focus.reliable or len(near) < 20:
        return None
    centre = np.median(near, 0)
    for _ in range(3):  # the wall behind the object is seen by many cameras too, but scattered
        reach = np.linalg.norm(near - centre, axis=-1)
        near = near[reach <= max(3 * np.median(reach), 1e-9)]
        centre = np.median(near, 0)
    low, high = np.quantile(near, [0.02, 0.98], axis=0)
    centre = (low + high) / 2
    return _sphere(centre, MARGIN * float(np.quantile(np.linalg.norm(near - centre, axis=-1), 0.97)), cameras)


def bound_of_masks(cameras: Sequence[Camera], masks: Sequence[np.ndarray], start: Bound) -> Bound | None:
    """The sphere about the region inside (nearly) every mask (H, W), searched from twice the starting sphere; None where there is none."""
    step = max(1, len(cameras) // HULL_VIEWS)
    chosen = [(c, _coarse(m)) for c, m in zip(cameras[::step], masks[::step], strict=True)]
    distance = float(np.median([np.linalg.norm(c.centre - start.centre) for c in cameras]))
    low = np.array(start.centre) - min(2 * start.radius, 0.9 * distance)
    high = np.array(start.centre) + min(2 * start.radius, 0.9 * distance)
    kept = np.empty((0, 3))
    cell = 0.0
    for _ in range(HULL_ROUNDS):
        cell = float((high - low).max()) / HULL_CELLS
        kept = _carve(_cells(low, high, cell), cell, chosen)
        if not len(kept):
            return None
        low, high = kept.min(0) - cell, kept.max(0) + cell
    centre = (low + high) / 2
    return _sphere(centre, MARGIN * float(np.linalg.norm(kept - centre, axis=-1).max() + 0.5 * cell), cameras)


def _cells(low: np.ndarray, high: np.ndarray, cell: float) -> np.ndarray:
    """(M, 3) centres of cubic cells that fill the box."""
    axes = [np.arange(a + cell / 2, b + cell / 2, cell) for a, b in zip(low, high, strict=True)]
    return np.stack(np.meshgrid(*axes, indexing="ij"), -1).reshape(-1, 3)


def _carve(points: np.ndarray, cell: float, views: list[tuple[Camera, np.ndarray]]) -> np.ndarray:
    """The points inside every mask that sees them, or nearly every one where that would cut much away; each stands for a cell."""
    seen, outside = np.zeros(len(points)), np.zeros(len(points))
    for camera, mask in views:
        pixel, depth = camera.project(points)
        visible = _in_image(camera, pixel, depth)
        scale = mask.shape[1] / camera.width
        # A cell counts as inside where any part of its image does, so that thin parts survive a coarse grid.
        reach = 0.87 * cell * camera.fx * scale / max(float(np.median(depth)), 1e-9)
        size = 2 * min(int(np.ceil(reach)), MASK_PIXELS) + 1
        wide = cv2.dilate(mask, np.ones((size, size), np.uint8))
        column, row = (np.clip(pixel * scale, 0, (wide.shape[1] - 1, wide.shape[0] - 1))).astype(np.int32).T
        seen += visible
        outside += visible & (wide[row, column] == 0)
    needed = max(2.0, len(views) / 3)
    tolerant = (seen >= needed) & (outside <= np.floor(MISSES * seen))
    # The few views from below are what ends the hull there, so a miss is forgiven only where masks do contradict each other.
    strict = tolerant & (outside == 0)
    return points[strict if strict.sum() > 0.6 * tolerant.sum() else tolerant]


def _coarse(mask: np.ndarray) -> np.ndarray:
    """(h, w) uint8, 1 where the object covers a part of the pixel."""
    scale = min(1.0, MASK_PIXELS / max(mask.shape))
    size = max(1, round(mask.shape[1] * scale)), max(1, round(mask.shape[0] * scale))
    return (cv2.resize(mask, size, interpolation=cv2.INTER_AREA) > 0.25).astype(np.uint8)


def _in_image(camera: Camera, pixel: np.ndarray, depth: np.ndarray) -> np.ndarray:
    """(N,) whether the projected points lie in front of the camera and inside its image."""
    return (depth > 0) & (pixel >= 0).all(-1) & (pixel[:, 0] < camera.width) & (pixel[:, 1] < camera.height)


def _sphere(centre: np.ndarray, radius: float, cameras: Sequence[Camera]) -> Bound:
    """A sphere that does not swallow the cameras, apart from a few."""
    distances = [np.linalg.norm(c.centre - centre) for c in cameras]
    x, y, z = (float(v) for v in centre)
    return Bound((x, y, z), min(radius, 0.95 * float(np.quantile(distances, 0.1))))
