# SPDX-License-Identifier: GPL-3.0-or-later
"""Planes of a view's pixels: depth and normal, drawn at random or taken over from half the resolution."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy.spatial import KDTree

from ..kernels.constants import WORST_COST
from ..scene.camera import Camera
from .matching_image import blocks

NEAREST_POINTS = 4  # sparse points in the image near a pixel, one of which gives its first depth
POINT_FRACTION = 0.75  # fraction of the pixels that start near sparse points
GUESS_FRACTION = 0.5  # fraction of the pixels that start near a guessed depth
DEPTH_SPREAD = 0.02  # relative standard deviation of depths around points and guesses
NORMAL_SPREAD = 0.4  # standard deviation of normals around the direction to the camera
MAX_FIRST_COSINE = -0.2  # normal . (x, y, 1) of a usable first normal is lower


class Planes(NamedTuple):
    """Planes of a view's pixels, in the camera's OpenCV axes; kernels change them in place.

    Attributes:
        depth: (H, W) float32 planar depth at the pixel's centre, 0 where nothing is searched.
        normal: (H, W, 3) float32 unit normal towards the camera.
        cost: (H, W) float32 matching cost.
        chosen: (H, W) int32 bit mask of the sources with the lowest cost.
    """

    depth: np.ndarray
    normal: np.ndarray
    cost: np.ndarray
    chosen: np.ndarray

    @classmethod
    def unmatched(cls, depth: np.ndarray, normal: np.ndarray) -> Planes:
        """Return planes whose cost is not known yet.

        Args:
            depth: (H, W) planar depth.
            normal: (H, W, 3) unit normal.
        """
        cost, chosen = np.full(depth.shape, WORST_COST, np.float32), np.zeros(depth.shape, np.int32)
        return cls(np.ascontiguousarray(depth, np.float32), np.ascontiguousarray(normal, np.float32), cost, chosen)

    def copy(self) -> Planes:
        """Return planes that can be changed without changing these."""
        return Planes(self.depth.copy(), self.normal.copy(), self.cost.copy(), self.chosen.copy())


@dataclass(frozen=True, eq=False)
class Bounds:
    """Depths in which a view is searched.

    Attributes:
        nearest, farthest: (H, W) float32 planar depths.
        guess: (H, W) float32 depth near which the search starts, 0 where none is known; None where there is none at all.
    """

    nearest: np.ndarray
    farthest: np.ndarray
    guess: np.ndarray | None = None

    @property
    def searched(self) -> np.ndarray:
        """Flags (H, W) of the pixels that are searched: 0 < nearest < farthest."""
        return (self.nearest > 0) & (self.farthest > self.nearest)

    def halved(self) -> Bounds:
        """Return the bounds at half resolution, each holding those of its four pixels."""
        searched = blocks(self.searched)
        nearest = np.where(searched, blocks(self.nearest), np.inf).min(-1)
        farthest = np.where(searched, blocks(self.farthest), 0).max(-1)
        nearest = np.where(searched.any(-1), nearest, 0)
        guess = None if self.guess is None else blocks(self.guess).max(-1)
        return Bounds(nearest.astype(np.float32), farthest.astype(np.float32), guess)


def rays(camera: Camera) -> np.ndarray:
    """Return the rays (x, y, 1) through the pixel centres, (H, W, 3) float32 in the camera's OpenCV axes."""
    x = (np.arange(camera.width) + 0.5 - camera.cx) / camera.fx
    y = (np.arange(camera.height) + 0.5 - camera.cy) / camera.fy
    x, y = np.meshgrid(x, y)
    return np.stack([x, y, np.ones_like(x)], -1).astype(np.float32)


def first_planes(camera: Camera, bounds: Bounds, points: np.ndarray | None, rng: np.random.Generator) -> Planes:
    """Draw planes: depths near sparse points or the guess, elsewhere uniform in inverse depth; normals about towards the camera.

    Args:
        camera: camera of the view.
        bounds: bounds of the depths.
        points: (P, 3) sparse points in the world, or None.
        rng: random numbers.
    """
    searched, shape = bounds.searched, bounds.nearest.shape
    depth = _uniform_depths(bounds, rng)
    if points is not None:
        known = _depths_of_points(camera, searched, points, rng) * rng.normal(1, DEPTH_SPREAD, shape)
        taken = (rng.random(shape) < POINT_FRACTION) & (bounds.nearest <= known) & (known <= bounds.farthest)
        depth = np.where(taken, known, depth)
    if bounds.guess is not None:
        known = np.clip(bounds.guess * rng.normal(1, DEPTH_SPREAD, shape), bounds.nearest, bounds.farthest)
        depth = np.where((rng.random(shape) < GUESS_FRACTION) & (bounds.guess > 0), known, depth)
    return Planes.unmatched(np.where(searched, depth, 0), _first_normals(camera, rng))


def finer_planes(camera: Camera, bounds: Bounds, coarse: Planes, coarse_camera: Camera, rng: np.random.Generator) -> Planes:
    """Take over the planes of half the resolution: each fine pixel gets the depth of the coarse pixel's plane along its own ray.

    Args:
        camera: camera at full resolution.
        bounds: bounds of the depths at full resolution.
        coarse: planes at half resolution.
        coarse_camera: camera at half resolution.
        rng: random numbers, for pixels whose plane is out of bounds.
    """
    rows = np.minimum(np.arange(camera.height) // 2, coarse_camera.height - 1)[:, None]
    columns = np.minimum(np.arange(camera.width) // 2, coarse_camera.width - 1)
    normal = coarse.normal[rows, columns]
    offset = coarse.depth * (coarse.normal * rays(coarse_camera)).sum(-1)  # n . X, the same for all points X of the plane
    along = np.minimum((normal * rays(camera)).sum(-1), -1e-3)
    depth = offset[rows, columns] / along
    usable = (bounds.nearest <= depth) & (depth <= bounds.farthest)
    depth = np.where(usable, depth, _uniform_depths(bounds, rng))
    return Planes.unmatched(np.where(bounds.searched, depth, 0), normal)


def _uniform_depths(bounds: Bounds, rng: np.random.Generator) -> np.ndarray:
    """Draw depths (H, W), uniform in inverse depth between the bounds; 1 where nothing is searched."""
    searched = bounds.searched
    low, high = (1 / np.where(searched, edge, 1) for edge in (bounds.farthest, bounds.nearest))
    return 1 / (low + (high - low) * rng.random(searched.shape))


def _depths_of_points(camera: Camera, searched: np.ndarray, points: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Return for each searched pixel the depth of one of the points that are nearest in the image, (H, W); 0 where no point is seen."""
    pixels, z = camera.project(points)
    inside = camera.in_image(pixels, z)
    depth = np.zeros(searched.shape)
    if inside.sum() >= NEAREST_POINTS and searched.any():
        rows, columns = np.nonzero(searched)
        near = np.asarray(KDTree(pixels[inside]).query(np.stack([columns, rows], -1) + 0.5, NEAREST_POINTS)[1])
        depth[rows, columns] = z[inside][near[np.arange(len(near)), rng.integers(0, NEAREST_POINTS, len(near))]]
    return depth


def _first_normals(camera: Camera, rng: np.random.Generator) -> np.ndarray:
    """Draw unit normals (H, W, 3) scattered around the direction to the camera."""
    ray = rays(camera)
    normal = rng.normal(0, NORMAL_SPREAD, ray.shape) - ray
    normal /= np.linalg.norm(normal, axis=-1, keepdims=True)
    towards = -ray / np.linalg.norm(ray, axis=-1, keepdims=True)
    return np.where(((normal * ray).sum(-1) < MAX_FIRST_COSINE)[..., None], normal, towards)
