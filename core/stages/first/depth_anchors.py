# SPDX-License-Identifier: GPL-3.0-or-later
"""Depth anchors: pixels whose depth is held at stereo's, because the photographs agree better there than at the surfels' own depth.

The normal consistency loss closes hollows whose shading is smooth, such as eye sockets, although stereo sees that they are open.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import torch

from ...scene.camera import Camera
from ...scene.dataset import Dataset
from ...stereo.depth_map import DepthMap
from ...stereo.settings import StereoSettings
from .depth_evidence import DepthEvidence
from .stereo_initialization import COMPARED_VIEWS
from .stereo_start import MIN_SUPPORT_MASKED

MAX_ERROR_RATIO = 0.8  # reprojection error at stereo's depth over that at the surfels', below which stereo's is taken
MIN_PARALLAX = 1.0  # pixels of parallax between the two depths of a region, from which they differ by more than noise
MIN_ANCHOR_SHARE = 0.003  # fraction of the object's pixels below which none is kept: chance finds 0.001 of them on smooth objects
HALF_LOSS_PARALLAX = 3.0  # pixels of parallax at which a difference counts half
MIN_OPACITY = 1e-3  # smallest opacity that depths are divided by


@dataclass(frozen=True, eq=False)
class DepthAnchors:
    """Depths of stereo at K pixels of V views, sorted by view: at first all that views agree on, after `choose` some of them.

    Attributes:
        begin: (V + 1,) int64; view i has the anchors begin[i] to begin[i + 1].
        pixel: (K,) int32 row times width plus column in the uncropped photograph.
        depth: (K,) float32 planar depth, world units.
        witnesses: (V, COMPARED_VIEWS) int64 views that each view is compared with, -1 for none.
        chosen: True after `choose`; there is no loss before.
    """

    begin: torch.Tensor
    pixel: torch.Tensor
    depth: torch.Tensor
    witnesses: torch.Tensor
    chosen: bool = False

    @classmethod
    def of_maps(cls, maps: Sequence[DepthMap]) -> DepthAnchors:
        """Collect the depths of stereo that enough views agree on for a start on them, from a depth map for each training view."""
        pixels = [np.flatnonzero(one.support >= MIN_SUPPORT_MASKED) for one in maps]
        depth = np.concatenate([one.depth.reshape(-1)[pixel] for one, pixel in zip(maps, pixels, strict=True)])
        begin = np.concatenate([[0], np.cumsum([len(pixel) for pixel in pixels])])
        witnesses = np.full((len(maps), COMPARED_VIEWS), -1)
        for row, one in zip(witnesses, maps, strict=True):
            row[: len(one.witnesses[:COMPARED_VIEWS])] = one.witnesses[:COMPARED_VIEWS]
        begin, pixel = torch.from_numpy(begin), torch.from_numpy(np.concatenate(pixels).astype(np.int32))
        return cls(begin, pixel, torch.from_numpy(depth), torch.from_numpy(witnesses))

    def choose(self, dataset: Dataset, depths: Sequence[np.ndarray]) -> DepthAnchors:
        """Keep the anchors in regions where stereo explains the photographs better than the surfels do.

        There the reprojection error is below MAX_ERROR_RATIO times the surfels', and below what is typical of stereo on this object: a
        reflection matches at the depth of its virtual image, but worse than a matt surface does. The depths differ by more than
        MIN_PARALLAX. If less than MIN_ANCHOR_SHARE of the object is found, none is kept.

        Args:
            dataset: training views with masks.
            depths: (H, W) float32 planar depth of the surfels in each training view, 0 for none.
        """
        stereo = [self._filled(i, depth) for i, depth in enumerate(depths)]
        sources = [row[row >= 0].tolist() for row in self.witnesses]
        evidence = DepthEvidence.collect(dataset.train, dataset.bound, (depths, stereo), sources, StereoSettings().relative_depth)
        typical, kept = evidence.typical_error(), []
        for i, (view, own) in enumerate(zip(dataset.train, depths, strict=True)):
            pixel, depth = self.of_view(i)
            rays = view.camera.rays().reshape(-1, 3)[pixel].astype(np.float64)
            points = view.camera.centre + depth[:, None].numpy() * rays
            better = (evidence.ratio(points) < MAX_ERROR_RATIO) & (evidence.error(points) < typical)
            kept.append(better & (evidence.distance(points) > MIN_PARALLAX) & (own.reshape(-1)[pixel] > 0))
        if sum(int(one.sum()) for one in kept) < MIN_ANCHOR_SHARE * sum(int((own > 0).sum()) for own in depths):
            kept = [np.zeros_like(one) for one in kept]
        begin = np.concatenate([[0], np.cumsum([one.sum() for one in kept])])
        keep = torch.from_numpy(np.concatenate(kept))
        return replace(self, begin=torch.from_numpy(begin), pixel=self.pixel[keep], depth=self.depth[keep], chosen=True)

    def of_view(self, view: int) -> tuple[torch.Tensor, torch.Tensor]:
        """Return pixels (K,) int64 and depths (K,) of a view's anchors."""
        part = slice(int(self.begin[view]), int(self.begin[view + 1]))
        return self.pixel[part].long(), self.depth[part]

    def _filled(self, view: int, depth: np.ndarray) -> np.ndarray:
        """Return a copy of a view's depth (H, W) with the anchors' depths where it has any."""
        pixel, anchored = self.of_view(view)
        copy = depth.reshape(-1).copy()
        copy[pixel] = np.where(copy[pixel] > 0, anchored, 0)
        return copy.reshape(depth.shape)

    def loss(self, view: int, sums: torch.Tensor, camera: Camera, full: Camera) -> torch.Tensor:
        """Compute the anchors' loss of a rendered view: the mean of d / (1 + d / HALF_LOSS_PARALLAX), d the parallax to the anchor.

        Args:
            view: index of the training view.
            sums: (C, H, W) of `rasterize`, depth and opacity last.
            camera: camera of the rendered image, which may be cropped.
            full: camera of the uncropped photograph.
        """
        pixel, anchored = (part.to(sums.device) for part in self.of_view(view))
        row = pixel // full.width - round(full.cy - camera.cy)
        column = pixel % full.width - round(full.cx - camera.cx)
        depth = sums[-2, row, column] / sums[-1, row, column].clamp_min(MIN_OPACITY)
        parallax = (depth - anchored).abs() * (full.fx / anchored)
        return (parallax / (1 + parallax / HALF_LOSS_PARALLAX)).sum() / (full.width * full.height)

    def state(self) -> dict[str, Any]:
        """Return the anchors for a checkpoint."""
        return dict(vars(self))

    @classmethod
    def of_state(cls, state: dict[str, Any], dataset: Dataset) -> DepthAnchors:
        """Return the anchors of a `state`; raise ValueError where they do not fit the training views."""
        one = cls(**state)
        views, count = len(dataset.train), len(one.pixel)
        types = (one.begin.dtype, one.pixel.dtype, one.depth.dtype, one.witnesses.dtype, type(one.chosen))
        fits = types == (torch.int64, torch.int32, torch.float32, torch.int64, bool) and one.witnesses.shape == (views, COMPARED_VIEWS)
        fits = fits and one.begin.shape == (views + 1,) and one.pixel.shape == one.depth.shape == (count,)
        fits = fits and bool((one.begin.diff() >= 0).all()) and one.begin[[0, -1]].tolist() == [0, count]
        fits = fits and bool(((one.witnesses >= -1) & (one.witnesses < views)).all() and (one.depth > 0).all())
        if not fits or any(not _inside(one.of_view(i)[0], view.camera) for i, view in enumerate(dataset.train)):
            raise ValueError("anchors of other views")
        return one


def _inside(pixel: torch.Tensor, camera: Camera) -> bool:
    """Return True where all pixels (K,) lie in a camera's image."""
    return bool(((pixel >= 0) & (pixel < camera.width * camera.height)).all())
