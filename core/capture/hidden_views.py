# SPDX-License-Identifier: GPL-3.0-or-later
"""Photographs in which other things hide the object: their masks would show less than its outline, or the thing before it."""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np

from ..scene.camera import Camera
from .dense_points import MAX_DEPTH_MAP_SIDE, DensePoints
from .object_region import ObjectRegion
from .soft_hull import projected_voxels

MAX_HIDDEN = 0.1  # fraction of the object's outline that may be hidden
# Sides in pixels of a depth map: gaps between the points of a thing are closed, then stray points dropped. A box hides .16, .28 and .62 of
# three captured objects so (.19, .30 and .67 by the true masks), and .05, .10 and .21 without. Things hide .04 at most in the other
# photographs of nine captures, .09 with points that are part of no thing.
CLOSED_SIDE, DROPPED_SIDE = 5, 5
MARGIN_VOXELS = 2.0  # voxels by which a thing must be nearer than the object to hide it


def hidden_views(cameras: Sequence[Camera], dense: DensePoints, region: ObjectRegion) -> list[bool]:
    """Return for each view whether other things hide more than MAX_HIDDEN of the object.

    Args:
        cameras: cameras of all views.
        dense: dense points of the scene.
        region: region of the object, and of other things.
    """
    position = dense.points.position.astype(np.float64)
    own, others = region.points(), position[region.labels(position) == 2]
    return [len(own) > 0 and _hidden_fraction(camera, own, others, region.step) > MAX_HIDDEN for camera in cameras]


def _hidden_fraction(camera: Camera, own: np.ndarray, other: np.ndarray, step: float) -> float:
    """Return the fraction of the outline of voxels (N, 3) before which points (M, 3) lie; 0 where the view does not show them."""
    small = camera.with_longest_side(min(MAX_DEPTH_MAP_SIDE, max(camera.width, camera.height)))
    outline = projected_voxels(small, own, step) > 0
    if not outline.any():
        return 0.0
    front, between = (_nearest(small, points) for points in (own, other))
    near = np.full_like(front, np.inf)  # voxels are wider than a pixel: the nearest one around each pixel
    rows, columns = np.nonzero(outline)
    reach = int(np.ceil(step * small.fx / max(float(np.min(front)), 1e-9)))
    padded = np.pad(front, reach, constant_values=np.inf)
    size = 2 * reach + 1
    near[rows, columns] = np.lib.stride_tricks.sliding_window_view(padded, (size, size))[rows, columns].min((-1, -2))
    hiding = _without_strays(outline & (between < near - MARGIN_VOXELS * step))
    return float(hiding[outline].mean())


def _without_strays(points: np.ndarray) -> np.ndarray:
    """Return the areas that pixels (H, W) bool cover, without gaps between them and without stray pixels."""
    closed = cv2.morphologyEx(points.astype(np.uint8), cv2.MORPH_CLOSE, np.ones((CLOSED_SIDE, CLOSED_SIDE), np.uint8))
    return cv2.morphologyEx(closed, cv2.MORPH_OPEN, np.ones((DROPPED_SIDE, DROPPED_SIDE), np.uint8)) > 0


def _nearest(camera: Camera, points: np.ndarray) -> np.ndarray:
    """Return the least depth (H, W) of the points (N, 3) in each pixel; infinite where there is none."""
    pixel, depth = camera.project(points)
    seen = camera.in_image(pixel, depth)
    column, row = pixel[seen].astype(np.int64).T
    image = np.full((camera.height, camera.width), np.inf)
    np.minimum.at(image, (row, column), depth[seen])
    return image
