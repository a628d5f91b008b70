# SPDX-License-Identifier: GPL-3.0-or-later
"""Carved hull: what can be solid around a region of virtual images, which stereo sees in metal.

What lies beside and behind a mirror is matt, and stereo sees that. So voxels in front of such points are empty, like those outside the
masks. What is left is a visual hull of the mirror, also inside the object's own outline.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
from scipy.ndimage import distance_transform_edt, gaussian_filter, map_coordinates
from scipy.spatial import KDTree
from skimage.measure import marching_cubes

from ...scene.dataset import View
from .depth_anchors import DepthAnchors

VOXELS = 56  # along the longest side of the region
MARGIN = 0.03  # radii of the bound around the region's points: stereo's points within it are images, too
CLEARANCE = 0.01  # radii of the bound by which a voxel must lie in front of a point to be empty
BLUR_VOXELS = 0.7  # standard deviation of the blur of the hull
NORMAL_BLUR_VOXELS = 1.0  # and of another one, along whose slope the normals lie


@dataclass(frozen=True, eq=False)
class CarvedHull:
    """Voxels around a region.

    Attributes:
        emptiness: (A, B, C) in 0..1; above .5 is outside of the hull.
        low: (3,) centre of the first voxel, world.
        side: side of a voxel, world units.
    """

    emptiness: np.ndarray
    low: np.ndarray
    side: float

    def at(self, values: np.ndarray, points: np.ndarray) -> np.ndarray:
        """Return values of the voxels (A, B, C) at points (..., 3), interpolated; 0 outside."""
        place = (points - self.low) / self.side
        return map_coordinates(values, place.reshape(-1, 3).T, order=1, mode="constant").reshape(points.shape[:-1])

    @property
    def has_surface(self) -> bool:
        """True where some voxels are empty and some are not."""
        return bool(self.emptiness.min() < 0.5 < self.emptiness.max())

    def depth(self, points: np.ndarray) -> np.ndarray:
        """Return the distance (N,) of points (N, 3) in the hull to its surface, world units; negative outside.

        Only for a hull with a surface.
        """
        solid = self.emptiness < 0.5
        inside, outside = (np.asarray(distance_transform_edt(part)) for part in (solid, ~solid))
        return self.at((inside - outside) * self.side, points)

    def surface(self) -> tuple[np.ndarray, np.ndarray]:
        """Return points (M, 3) of the surface, about one for each square of a voxel's side, and their normals (M, 3), outwards.

        Where the voxels end there are none. Only for a hull with a surface.
        """
        place = np.asarray(marching_cubes(self.emptiness, 0.5)[0], np.float64)
        place = place[((place > 1) & (place < np.array(self.emptiness.shape) - 2)).all(1)]
        slope = np.gradient(gaussian_filter(self.emptiness, NORMAL_BLUR_VOXELS))
        normal = np.stack([map_coordinates(one, place.T, order=1) for one in slope], -1)
        return self.low + self.side * place, normal / np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-12)


def carve_hull(views: Sequence[View], anchors: DepthAnchors, points: np.ndarray, radius: float) -> CarvedHull:
    """Carve voxels around a region by the points of stereo that are seen behind them, and by the masks.

    Args:
        views: training views.
        anchors: stereo's depths in them.
        points: (M, 3) of the region, world.
        radius: of the bound, world units.
    """
    tree, low, high = KDTree(points), points.min(0) - MARGIN * radius, points.max(0) + MARGIN * radius
    side = float((high - low).max() / VOXELS)
    axes = [np.arange(low[axis], high[axis] + side, side) for axis in range(3)]
    voxels = np.stack(np.meshgrid(*axes, indexing="ij"), -1).reshape(-1, 3)
    empty = np.zeros(len(voxels), bool)
    for number, view in enumerate(views):
        depth = _matt_depth(view, *anchors.of_view(number), tree, MARGIN * radius)
        pixel, distance = view.camera.project(voxels)
        inside = view.camera.in_image(pixel, distance)
        column, row = pixel[inside].astype(int).T
        empty[inside] |= depth[row, column] > distance[inside] + CLEARANCE * radius
    emptiness = gaussian_filter(empty.reshape([len(axis) for axis in axes]).astype(float), BLUR_VOXELS)
    return CarvedHull(emptiness, low, side)


def _matt_depth(view: View, pixel: torch.Tensor, depth: torch.Tensor, images: KDTree, margin: float) -> np.ndarray:
    """Return the depth (H, W) of what a view shows beside a region: infinite beside the object, 0 where it is not known.

    Args:
        view: training view.
        pixel: (K,) flat indices of the pixels whose depth stereo knows.
        depth: (K,) planar.
        images: the region's points.
        margin: distance from them within which a point is one of them.
    """
    camera, pixels, depths = view.camera, pixel.numpy(), depth.numpy()
    result = np.zeros(camera.width * camera.height)
    points = camera.centre + camera.rays().reshape(-1, 3)[pixels] * depths[:, None]
    beside = images.query(points, distance_upper_bound=margin)[0] == np.inf
    result[pixels[beside]] = depths[beside]
    if view.alpha is not None:
        result[view.alpha.reshape(-1) < 0.5] = np.inf
    return result.reshape(camera.height, camera.width)
