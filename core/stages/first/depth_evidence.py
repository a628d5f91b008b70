# SPDX-License-Identifier: GPL-3.0-or-later
"""Evidence for one of two surfaces, region by region: whose depth makes the photographs agree with each other.

Dense stereo sees hollows, which no silhouette shows, but it guesses where there is no texture; the visual hull is exact where it touches
the object. The reprojection errors of both are summed in voxels around both surfaces.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
from scipy.ndimage import gaussian_filter

from ...kernels.rasterize import rasterize
from ...scene.dataset import Bound, Dataset, View
from ...scene.gaussians import Gaussians
from ...stereo.reprojection import reprojection_errors

VOXEL_SIDE = 0.02  # side of a voxel in radii of the bound
BLUR_VOXELS = 1.5  # standard deviation, in voxels, of the blur that turns voxels into regions
MIN_COUNT = 1e-9  # least count that sums are divided by
MIN_OPACITY = 0.5  # opacity from which a rendered pixel has a depth
MIN_ALPHA = 0.95  # alpha from which a pixel is compared


@dataclass(frozen=True, eq=False)
class DepthEvidence:
    """Errors of two surfaces in voxels.

    Attributes:
        bound: sphere that the voxels cover.
        first: (N, N, N) sum of the first surface's reprojection errors, blurred.
        second: (N, N, N) sum of the second's, of the same pixels.
        count: (N, N, N) number of these pixels, blurred likewise.
        parallax: (N, N, N) distance of the second surface from the first in pixels, the mean of those pixels at which they differ.
    """

    bound: Bound
    first: np.ndarray
    second: np.ndarray
    count: np.ndarray
    parallax: np.ndarray

    @classmethod
    def collect(
        cls,
        views: Sequence[View],
        bound: Bound,
        depths: tuple[Sequence[np.ndarray], Sequence[np.ndarray]],
        sources: Sequence[Sequence[int]],
        relative: float,
    ) -> DepthEvidence:
        """Sum the errors of the pixels at which both surfaces can be compared.

        Args:
            views: photographs with masks.
            bound: sphere around the object.
            depths: (H, W) planar depth of each view, 0 for none, of the first and of the second surface.
            sources: indices of the views that each view is compared with.
            relative: see `reprojection_errors`.
        """
        errors = [reprojection_errors(views, one, sources, relative) for one in depths]
        count = int(np.ceil(2 / VOXEL_SIDE)) + 1
        sums = np.zeros((5, count, count, count))
        for i, view in enumerate(views):
            assert view.alpha is not None
            valid = np.isfinite(errors[0][i]) & np.isfinite(errors[1][i]) & (view.alpha > MIN_ALPHA)
            rays = view.camera.rays()[valid].astype(np.float64)
            own, other = (one[i][valid] for one in depths)
            shift = view.camera.fx * (other - own) / own
            values = (errors[0][i][valid], errors[1][i][valid], np.ones(len(rays)), shift, shift != 0)
            for depth in (own, other):
                cells = tuple(_cells(view.camera.centre + depth[:, None] * rays, bound, count).T)
                for total, value in zip(sums, values, strict=True):
                    np.add.at(total, cells, value)
        first, second, compared, shift, moved = (gaussian_filter(total, BLUR_VOXELS).astype(np.float32) for total in sums)
        return cls(bound, first, second, compared, np.abs(shift) / np.maximum(moved, MIN_COUNT))

    def ratio(self, points: np.ndarray) -> np.ndarray:
        """Return the second surface's error over the first's around points (N, 3), as (N,); 1 where nothing was compared."""
        cells = tuple(_cells(points, self.bound, len(self.first)).T)
        first, second = self.first[cells], self.second[cells]
        return np.where(first > 0, second / np.maximum(first, 1e-20), 1.0)

    def error(self, points: np.ndarray) -> np.ndarray:
        """Return the second surface's mean error around points (N, 3), as (N,); 0 where nothing was compared."""
        cells = tuple(_cells(points, self.bound, len(self.first)).T)
        return self.second[cells] / np.maximum(self.count[cells], MIN_COUNT)

    def typical_error(self) -> float:
        """Return the median over the voxels of the second surface's mean error."""
        seen = self.count > 1
        return float(np.median(self.second[seen] / self.count[seen])) if seen.any() else 0.0

    def distance(self, points: np.ndarray) -> np.ndarray:
        """Return the distance of the two surfaces around points (N, 3) in pixels of parallax, as (N,); noise cancels in the mean."""
        return self.parallax[tuple(_cells(points, self.bound, len(self.first)).T)]


def _cells(points: np.ndarray, bound: Bound, count: int) -> np.ndarray:
    """Return the voxels (N, 3) of points (N, 3), those outside at the border."""
    place = ((points - np.asarray(bound.centre)) / bound.radius + 1) / VOXEL_SIDE
    return np.clip(np.round(place).astype(int), 0, count - 1)


@torch.no_grad()
def rendered_depths(gaussians: Gaussians, dataset: Dataset) -> list[np.ndarray]:
    """Return the planar depth (H, W) of Gaussians in each training view, 0 where they are not opaque.

    Args:
        gaussians: the Gaussians.
        dataset: views, and the bound that sets the scale.
    """
    g, depths = gaussians, []
    parameters = (g.position, g.quaternion, g.log_scale, g.opacity, g.sh, g.position.new_zeros(0, g.count))
    for view in dataset.train:
        sums, _ = rasterize(*parameters, view.camera, dataset.bound.radius, 0)
        depth, alpha = sums[-2:].cpu().numpy()
        depths.append(np.where(alpha > MIN_OPACITY, depth / np.maximum(alpha, MIN_OPACITY), np.float32(0)))
    return depths
