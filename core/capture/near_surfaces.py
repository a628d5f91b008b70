# SPDX-License-Identifier: GPL-3.0-or-later
"""Surroundings of the captured object from dense points: the table as a closed plane, and other near surfaces."""

from __future__ import annotations

import numpy as np
from scipy.spatial import KDTree

from ..io.srgb import decode_srgb
from ..scene.dataset import Bound
from ..scene.surroundings import Surroundings
from ..scene.voxel_means import voxel_means
from ..stereo.fusion import OrientedPoints
from .support_plane import SupportPlane

SURFACE_REACH = 5.0  # distance from the object's centre up to which surfaces count, radii of the object
POINT_SPACING = 1 / 15  # of the points, radii of the object
CLEARANCE = 2.0  # spacings that other surfaces keep from the plane
MIN_OBJECT_DISTANCE = 1.3  # radii of the object within which other points are none: stereo's errors at the object's outline would shadow it
COLOUR_NEIGHBOURS = 4  # points of the plane whose colours are averaged
MIN_POINTS = 50  # points, below which there are no surroundings


def near_surfaces(points: OrientedPoints, on_object: np.ndarray, plane: SupportPlane | None, bound: Bound) -> Surroundings | None:
    """Return the surfaces around an object, or None where there are hardly any.

    The plane is closed below the object, where no photograph sees it; its colour there is that of the nearest visible parts.

    Args:
        points: N dense points of the scene.
        on_object: (N,) bool, points of the object.
        plane: plane that the object stands on, or None.
        bound: bounding sphere of the object.
    """
    centre, spacing = np.asarray(bound.centre), POINT_SPACING * bound.radius
    near = np.linalg.norm(points.position - centre, axis=1) < SURFACE_REACH * bound.radius
    others = points.select(near & ~on_object)
    if len(others.position) < MIN_POINTS:
        return None
    height = np.full(len(others.position), np.inf) if plane is None else np.abs(plane.height(others.position))
    free = height > CLEARANCE * spacing
    free &= np.linalg.norm(others.position - centre, axis=1) > MIN_OBJECT_DISTANCE * bound.radius
    place, normal, colour = _averaged(others.select(free), spacing)
    on_plane = others.select(height <= CLEARANCE * spacing)
    if plane is not None and len(on_plane.position) >= COLOUR_NEIGHBOURS:
        grid = _plane_grid(plane, centre, SURFACE_REACH * bound.radius, spacing)
        _, nearest = KDTree(on_plane.position).query(grid, k=COLOUR_NEIGHBOURS)
        place, normal = np.concatenate([place, grid]), np.concatenate([normal, np.tile(plane.normal, (len(grid), 1))])
        colour = np.concatenate([colour, decode_srgb(on_plane.colour[nearest]).mean(1)])
    return Surroundings(*(a.astype(np.float32) for a in (place, normal, colour, np.full(len(place), spacing))))


def _averaged(points: OrientedPoints, size: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Average points in voxels; returns positions, unit normals and linear colours (M, 3)."""
    if not len(points.position):
        return np.zeros((0, 3)), np.zeros((0, 3)), np.zeros((0, 3))
    cells = np.floor(points.position / size).astype(np.int64)
    (position, normal, colour), _ = voxel_means(cells, (points.position, points.normal, decode_srgb(points.colour)))
    normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-9)
    return position, normal, colour


def _plane_grid(plane: SupportPlane, centre: np.ndarray, reach: float, spacing: float) -> np.ndarray:
    """Return the points (M, 3) of a grid on the plane's extent, up to `reach` from the centre."""
    axes = plane.axes()
    middle = centre - plane.height(centre[None])[0] * plane.normal
    steps = np.arange(-reach, reach + spacing, spacing)
    u, v = np.meshgrid(steps, steps)
    grid = middle + u.reshape(-1, 1) * axes[0] + v.reshape(-1, 1) * axes[1]
    return grid[(np.linalg.norm(grid - middle, axis=1) < reach) & plane.over(grid)]
