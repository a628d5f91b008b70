# SPDX-License-Identifier: GPL-3.0-or-later
"""Bounding sphere of the object, estimated from the region inside every mask, the sparse points, or the cameras alone."""

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

MARGIN = 1.08  # factor of the estimated radius
FRAME_MARGIN = 1.5  # the object's radius is at most this factor of that of the sphere that fills the images
HULL_CELLS = 40  # along a side of the carving grid
HULL_ROUNDS = 3  # each fits the grid to the cells left by the last one
HULL_VIEWS = 32
MASK_PIXELS = 256  # masks are reduced to at most this size
MISSES = 0.05  # fraction of the views that may contradict a cell: masks are never perfect


@dataclass(frozen=True, eq=False)
class LookAtPoint:
    """Point that the cameras look at.

    Attributes:
        point: (3,) the point nearest to all viewing axes.
        distance: median distance of the cameras to it.
        reliable: True if most cameras face it and their axes are not nearly parallel.
    """

    point: np.ndarray
    distance: float
    reliable: bool


def object_bound(parsed: ParsedDataset, views: list[View], settings: DataSettings, warnings: list[str]) -> Bound:
    """Return the bounding sphere of the object: that of the settings or of the dataset's files, else an estimate.

    Args:
        parsed: the dataset's description; its bound is used if it has one.
        views: training views.
        settings: `centre` and `radius`, in the dataset's own frame, have precedence.
        warnings: warnings about the estimate are appended.

    Raises:
        InputError: if the bound is empty or not finite.
    """
    bound = parsed.bound or _estimated_bound(views, parsed.points, warnings)
    centre, radius = bound.centre, bound.radius
    if settings.centre is not None:
        x, y, z = parsed.to_world[:3, :3] @ np.array(settings.centre, np.float64) + parsed.to_world[:3, 3]
        centre = float(x), float(y), float(z)
    if settings.radius is not None:
        radius = settings.radius * float(np.cbrt(np.linalg.det(parsed.to_world[:3, :3])))
    if not np.isfinite((*centre, radius)).all() or radius <= 0:
        raise InputError("data.centre, data.radius", "the object's bound is empty or not finite", "give a centre and a positive radius")
    return Bound(centre, radius)


def _estimated_bound(views: list[View], points: PointCloud | None, warnings: list[str]) -> Bound:
    cameras = [v.camera for v in views]
    from_points = bound_of_points(cameras, points.position.astype(np.float64)) if points is not None else None
    start = from_points or bound_of_cameras(cameras)
    masked = [(v.camera, v.alpha) for v in views if v.alpha is not None]
    if len(masked) >= MINIMUM_VIEWS:
        hull = bound_of_masks([c for c, _ in masked], [a for _, a in masked], start)
        if hull is not None:
            return hull
        warnings.append("no region lies inside all masks, so masks and cameras don't match; the object's bound is estimated without masks")
    if from_points is None and not find_look_at_point(cameras).reliable:
        warnings.append("the cameras don't look at one point, so the object's bound is uncertain; set data.centre and data.radius")
    return start


def find_look_at_point(cameras: Sequence[Camera]) -> LookAtPoint:
    """Intersect the viewing axes of two or more cameras by robust (iteratively reweighted) least squares."""
    centres = np.stack([c.centre for c in cameras])
    axes = np.stack([c.forward for c in cameras])
    across = np.eye(3) - axes[:, :, None] * axes[:, None, :]  # (N, 3, 3) projection onto the plane normal to each axis
    weights = np.ones(len(cameras))
    point = centres.mean(0)
    spread = 0.0
    for _ in range(8):
        normal = (weights[:, None, None] * across).sum(0)
        spread = np.linalg.eigvalsh(normal)[0] / weights.sum()
        point = np.linalg.lstsq(normal, (weights[:, None] * np.einsum("nij,nj->ni", across, centres)).sum(0), rcond=1e-9)[0]
        misses = np.linalg.norm(np.einsum("nij,nj->ni", across, point - centres), axis=-1)
        weights = 1 / np.maximum(misses, 0.25 * np.median(misses) + 1e-12)
        weights /= weights.max()
    ahead = np.einsum("ni,ni->n", point - centres, axes) > 0
    distance = float(np.median(np.linalg.norm(centres - point, axis=-1)))
    # Axes within about two degrees of parallel do not determine the depth.
    return LookAtPoint(point, distance, bool(spread > 1e-3 and ahead.mean() > 0.5))


def bound_of_cameras(cameras: Sequence[Camera]) -> Bound:
    """Return the sphere about the look-at point that fills the images."""
    target = find_look_at_point(cameras)
    half_angles = [np.arctan(min(c.width / c.fx, c.height / c.fy) / 2) for c in cameras]
    return _sphere(target.point, target.distance * float(np.sin(np.median(half_angles))), cameras)


def bound_of_points(cameras: Sequence[Camera], points: np.ndarray) -> Bound | None:
    """Return the sphere about the sparse points near the look-at point that at least half of the cameras see.

    Args:
        cameras: cameras in the frame of the points.
        points: (P, 3) sparse points.

    Returns:
        The sphere, or None if the cameras don't look at one point or fewer than 20 points are left.
    """
    target = find_look_at_point(cameras)
    seen = np.zeros(len(points))
    for camera in cameras:
        seen += camera.in_image(*camera.project(points))
    framed = min(FRAME_MARGIN * bound_of_cameras(cameras).radius, 0.8 * target.distance)
    near = points[(seen >= 0.5 * len(cameras)) & (np.linalg.norm(points - target.point, axis=-1) < framed)]
    if not target.reliable or len(near) < 20:
        return None
    centre = np.median(near, 0)
    for _ in range(3):  # many cameras see the background behind the object too, but its points are scattered
        reach = np.linalg.norm(near - centre, axis=-1)
        near = near[reach <= max(3 * np.median(reach), 1e-9)]
        centre = np.median(near, 0)
    low, high = np.quantile(near, [0.02, 0.98], axis=0)
    centre = (low + high) / 2
    return _sphere(centre, MARGIN * float(np.quantile(np.linalg.norm(near - centre, axis=-1), 0.97)), cameras)


def bound_of_masks(cameras: Sequence[Camera], masks: Sequence[np.ndarray], start: Bound) -> Bound | None:
    """Return the sphere about the region inside (nearly) every mask, found by carving a grid that is refined HULL_ROUNDS times.

    The carving is coarse and tolerates masks that contradict each other, as only a sphere is wanted. The hull that the first stage starts
    on is carved inside this sphere by `core.stages.first.visual_hull`, at full mask resolution and without tolerance.

    Args:
        cameras: one per mask.
        masks: (H, W) float32 each, 1 on the object.
        start: the first grid covers twice this sphere.

    Returns:
        The sphere, or None if no region is inside the masks.
    """
    step = max(1, len(cameras) // HULL_VIEWS)
    chosen = [(c, _coarse_mask(m)) for c, m in zip(cameras[::step], masks[::step], strict=True)]
    distance = float(np.median([np.linalg.norm(c.centre - start.centre) for c in cameras]))
    low = np.array(start.centre) - min(2 * start.radius, 0.9 * distance)
    high = np.array(start.centre) + min(2 * start.radius, 0.9 * distance)
    hull = np.empty((0, 3))
    cell = 0.0
    for _ in range(HULL_ROUNDS):
        cell = float((high - low).max()) / HULL_CELLS
        hull = _carve(_cells(low, high, cell), cell, chosen)
        if not len(hull):
            return None
        low, high = hull.min(0) - cell, hull.max(0) + cell
    centre = (low + high) / 2
    return _sphere(centre, MARGIN * float(np.linalg.norm(hull - centre, axis=-1).max() + 0.5 * cell), cameras)


def _cells(low: np.ndarray, high: np.ndarray, cell: float) -> np.ndarray:
    """Return the centres (M, 3) of the cubic cells that fill a box."""
    axes = [np.arange(a + cell / 2, b + cell / 2, cell) for a, b in zip(low, high, strict=True)]
    return np.stack(np.meshgrid(*axes, indexing="ij"), -1).reshape(-1, 3)


def _carve(points: np.ndarray, cell: float, views: list[tuple[Camera, np.ndarray]]) -> np.ndarray:
    """Return the cells inside every mask that sees them, or inside nearly every one if that would remove over 40 % of them.

    A view whose mask does not reach the border shows the whole object, so a cell outside its image is outside the object. Without this
    rule, cells near the cameras, which only the few views from the other side contain, would survive.

    Args:
        points: (M, 3) centres of the cells.
        cell: side of a cell.
        views: camera and mask (h, w) uint8 of each view.
    """
    seen, outside = np.zeros(len(points)), np.zeros(len(points))
    for camera, mask in views:
        pixel, depth = camera.project(points)
        visible = camera.in_image(pixel, depth)
        scale = mask.shape[1] / camera.width
        # A cell counts as inside if any part of its image is, so that thin parts survive a coarse grid.
        reach = 0.87 * cell * camera.fx * scale / max(float(np.median(depth)), 1e-9)
        size = 2 * min(int(np.ceil(reach)), MASK_PIXELS) + 1
        wide = cv2.dilate(mask, np.ones((size, size), np.uint8))
        column, row = (np.clip(pixel * scale, 0, (wide.shape[1] - 1, wide.shape[0] - 1))).astype(np.int32).T
        informed = visible | _shows_whole_object(mask)
        seen += informed
        outside += informed & ~(camera.in_image(pixel, depth, reach / scale) & (wide[row, column] > 0))
    needed = max(2.0, len(views) / 3)
    tolerant = (seen >= needed) & (outside <= np.floor(MISSES * seen))
    # The few views from below alone bound the hull there, so misses are tolerated only where masks do contradict each other.
    strict = tolerant & (outside == 0)
    return points[strict if strict.sum() > 0.6 * tolerant.sum() else tolerant]


def _coarse_mask(mask: np.ndarray) -> np.ndarray:
    """Reduce a mask (H, W) to (h, w) uint8 with at most MASK_PIXELS a side, 1 where the object covers over a quarter of the pixel."""
    scale = min(1.0, MASK_PIXELS / max(mask.shape))
    size = max(1, round(mask.shape[1] * scale)), max(1, round(mask.shape[0] * scale))
    return (cv2.resize(mask, size, interpolation=cv2.INTER_AREA) > 0.25).astype(np.uint8)


def _shows_whole_object(mask: np.ndarray) -> bool:
    """Return True where a mask (h, w) is neither empty nor reaches the image's border: the object is inside the image."""
    border = mask[0].any() or mask[-1].any() or mask[:, 0].any() or mask[:, -1].any()
    return bool(mask.any() and not border)


def _sphere(centre: np.ndarray, radius: float, cameras: Sequence[Camera]) -> Bound:
    """Return a sphere whose radius is limited so that at least nine tenths of the cameras are outside."""
    distances = [np.linalg.norm(c.centre - centre) for c in cameras]
    x, y, z = (float(v) for v in centre)
    return Bound((x, y, z), min(radius, 0.95 * float(np.quantile(distances, 0.1))))
