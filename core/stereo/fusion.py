# SPDX-License-Identifier: GPL-3.0-or-later
"""Fusion of depth maps into oriented, coloured points."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from .consistency import add_samples
from .depth_map import DepthMap, camera_matrices
from .settings import StereoSettings


@dataclass(frozen=True, eq=False)
class OrientedPoints:
    """Points of surfaces, fused from depth maps.

    Attributes:
        position: (N, 3) float32 in the world.
        normal: (N, 3) float32 unit normal, towards the cameras that saw the point.
        colour: (N, 3) float32 sRGB-encoded, the mean of the views.
        support: (N,) int32 number of views whose depths were averaged, at least 1.
    """

    position: np.ndarray
    normal: np.ndarray
    colour: np.ndarray
    support: np.ndarray

    def select(self, keep: np.ndarray) -> OrientedPoints:
        """Return the points where `keep` (N,) is True."""
        return OrientedPoints(self.position[keep], self.normal[keep], self.colour[keep], self.support[keep])

    def joined(self, other: OrientedPoints) -> OrientedPoints:
        """Return these points, followed by others."""
        return OrientedPoints(*(np.concatenate(pair) for pair in zip(vars(self).values(), vars(other).values(), strict=True)))


def fuse_points(
    maps: Sequence[DepthMap],
    colours: Sequence[np.ndarray],
    min_support: int = 2,
    settings: StereoSettings = StereoSettings(),  # noqa: B008 (immutable)
) -> OrientedPoints:
    """Fuse the supported depths of all views, each pixel into one point at most.

    Pixel by pixel, the first view in order that sees a place gives a point; the pixels of its witnesses that see the same place are
    averaged with it and give no points of their own.

    Args:
        maps: depth maps of one estimation, in its order.
        colours: (H, W, 3) sRGB-encoded image of each view.
        min_support: number of witnesses that have to agree with a depth.
        settings: the limit of relative depth.
    """
    depths = [np.where(one.support >= min_support, one.depth, np.float32(0)) for one in maps]
    used = [np.zeros(depth.shape, bool) for depth in depths]
    parts = []
    for i, one in enumerate(maps):
        free = (depths[i] > 0) & ~used[i]
        points = one.points()[free]
        sums = np.concatenate([points, one.normal[free], colours[i][free]], -1, dtype=np.float64)
        total = np.ones(len(points), np.int32)
        for k in one.witnesses:
            other = maps[k].camera
            layers = depths[k], maps[k].normal, np.ascontiguousarray(colours[k], np.float32)
            add_samples(points, camera_matrices(other), other.centre.copy(), *layers, settings.relative_depth, used[k], sums, total)
        parts.append((sums, total))
    return _means(*(np.concatenate(arrays) for arrays in zip(*parts, strict=True)))


def _means(sums: np.ndarray, total: np.ndarray) -> OrientedPoints:
    """Turn sums (N, 9) of positions, normals and colours, and their counts (N,), into means; normals become unit vectors."""
    position, normal, colour = np.split(sums / total[:, None], 3, axis=-1)
    normal = normal / np.maximum(np.linalg.norm(normal, axis=-1, keepdims=True), 1e-12)
    return OrientedPoints(position.astype(np.float32), normal.astype(np.float32), colour.astype(np.float32), total)
