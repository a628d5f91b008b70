# SPDX-License-Identifier: GPL-3.0-or-later
"""Sparse voxel grid around the object: blocks that can contain the surface."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy import ndimage

from ..errors import IrgsppError
from ..scene.camera import Camera
from ..scene.dataset import Bound
from ..scene.gbuffer import GBuffer, SurfaceSamples
from ..settings.schema import SurfaceSettings
from ..settings.sizes import voxels_along

BLOCK = 4  # voxels along a block's side
MARGIN = 6  # voxels between the object and the border of the grid


@dataclass(frozen=True, eq=False)
class Grid:
    """Voxel grid in blocks of BLOCK^3 voxels.

    Attributes:
        origin: (3,) float64, world position of the centre of voxel (0, 0, 0).
        voxel: side of a voxel, world units.
        blocks: number of blocks along each axis.
        active: (B, 3) int32 indices of the blocks near depths or Gaussians; other blocks are neither stored nor meshed.
    """

    origin: np.ndarray
    voxel: float
    blocks: tuple[int, int, int]
    active: np.ndarray

    @property
    def shape(self) -> tuple[int, int, int]:
        """Number of voxels along each axis."""
        x, y, z = self.blocks
        return x * BLOCK, y * BLOCK, z * BLOCK

    def table(self) -> np.ndarray:
        """Return the number of the active block at each place, -1 for none, with a border of -1: (X + 2, Y + 2, Z + 2) int32."""
        table = np.full([n + 2 for n in self.blocks], -1, np.int32)
        table[tuple((self.active + 1).T)] = np.arange(len(self.active))
        return table

    def dense(self, values: np.ndarray, fill: float) -> np.ndarray:
        """Make a dense volume.

        Args:
            values: (B, BLOCK^3) of the active blocks.
            fill: value elsewhere.

        Returns:
            (X, Y, Z) volume of `shape`.
        """
        x, y, z = self.blocks
        volume = np.full((x, y, z, BLOCK**3), fill, values.dtype)
        volume[tuple(self.active.T)] = values
        volume = volume.reshape(x, y, z, BLOCK, BLOCK, BLOCK).transpose(0, 3, 1, 4, 2, 5)
        return volume.reshape(self.shape)


def depth_points(view: GBuffer, bound: Bound) -> np.ndarray:
    """Back-project the pixels with alpha > 0.5 whose depth falls inside the bound.

    Args:
        view: G-buffer.
        bound: sphere around the object.

    Returns:
        (P, 3) world points.
    """
    seen = (view.alpha > 0.5) & np.isfinite(view.depth) & (view.depth > 0)
    points = view.camera.centre + view.depth[seen][:, None].astype(np.float64) * view.camera.rays()[seen]
    return points[_inside(points, bound)]


def make_grid(views: Sequence[GBuffer], samples: SurfaceSamples, bound: Bound, settings: SurfaceSettings) -> Grid:
    """Make a voxel grid around the object, as fine as the views' pixels ask for.

    Args:
        views: G-buffers.
        samples: the Gaussians; opaque ones activate blocks, too.
        bound: sphere around the object.
        settings: size of the voxels.

    Raises:
        IrgsppError: no view has a depth inside the bound.
    """
    solid = samples.position[(samples.opacity > 0.5) & _inside(samples.position, bound)].astype(np.float64)
    seen, footprints = [], []
    for view in views:
        seen.append(depth_points(view, bound))
        footprints.append(footprint(view.camera, seen[-1]))
    if not sum(map(len, seen)):
        raise IrgsppError("no surface: no view has a depth inside the object's bound where its alpha is above 0.5")
    low, high = _robust_box(solid if len(solid) else np.concatenate(seen))
    longest = float((high - low).max())
    voxel = longest / voxels_along(settings, longest / float(np.nanmedian(footprints)))
    blocks = np.ceil(((high - low) / voxel + 2 * MARGIN) / BLOCK).astype(int)
    origin = (low + high) / 2 - (blocks * BLOCK - 1) / 2 * voxel
    marked = np.zeros(blocks, bool)
    for points in [solid, *seen]:
        index = np.floor(((points - origin) / voxel + 0.5) / BLOCK).astype(int)
        index = index[((index >= 0) & (index < blocks)).all(-1)]
        marked[tuple(index.T)] = True
    active = np.argwhere(ndimage.binary_dilation(marked, np.ones((3, 3, 3)))).astype(np.int32)
    return Grid(origin, voxel, (int(blocks[0]), int(blocks[1]), int(blocks[2])), active)


def footprint(camera: Camera, points: np.ndarray) -> float:
    """Return the side of a camera's pixel at the mean depth of points (P, 3), world units; not a number without points."""
    if not len(points):
        return math.nan
    depth = (points.mean(0) - camera.centre) @ camera.world_to_cv[2, :3]
    return float(depth) / math.sqrt(camera.fx * camera.fy)


def _inside(points: np.ndarray, bound: Bound) -> np.ndarray:
    """Return (P,) True for points (P, 3) inside the bound."""
    return np.linalg.norm(points - np.asarray(bound.centre), axis=-1) < bound.radius


def _robust_box(points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the corners of a box of points (P, 3) that excludes outliers, but contains thin tips, which are rare among the points."""
    low, high = np.quantile(points, [0.005, 0.995], axis=0)
    reach = 0.15 * (high - low).max()
    kept = points[((points >= low - reach) & (points <= high + reach)).all(-1)]
    return kept.min(0), np.maximum(kept.max(0), kept.min(0) + 1e-6 * (1 + np.abs(kept).max()))
