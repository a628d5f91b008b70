# SPDX-License-Identifier: GPL-3.0-or-later
"""Sparse model of a capture: cameras of the photographs, and points with their observations."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from ..datasets.parsed_dataset import Lens
from ..scene.dataset import PointCloud
from .photograph import LeftOut, Photograph

MIN_OBSERVATIONS = 2  # of a point: one photograph alone does not tell its place, and COLMAP takes no such point


@dataclass(frozen=True, eq=False)
class PosedPhotograph:
    """Photograph with its camera.

    Attributes:
        photograph: its image has the lens' size.
        lens: intrinsics with distortion, of the upright image.
        to_world: (4, 4) float64 rigid camera to world, looking along -Z, +Y up.
    """

    photograph: Photograph
    lens: Lens
    to_world: np.ndarray


@dataclass(frozen=True, eq=False)
class SparseModel:
    """Cameras and points in one frame, whose scale and orientation are arbitrary until the table or a marker gives them.

    Attributes:
        posed: photographs that were registered.
        position: (P, 3) float64 points.
        colour: (P, 3) uint8 sRGB.
        track_point, track_photograph: (T,) int32, the point and the index in `posed` of each observation.
        track_pixel: (T, 2) float32 place of each observation in the distorted upright image; the first pixel's centre is at (0.5, 0.5).
        error: mean reprojection error, pixels; None for cameras that a dataset gives, whose points have no observations.
        left_out: photographs that were not registered.
    """

    posed: list[PosedPhotograph]
    position: np.ndarray
    colour: np.ndarray
    track_point: np.ndarray
    track_photograph: np.ndarray
    track_pixel: np.ndarray
    error: float | None
    left_out: list[LeftOut]

    @property
    def has_given_cameras(self) -> bool:
        """True where a dataset gave the cameras, and none was searched."""
        return self.error is None

    @property
    def points(self) -> PointCloud | None:
        """Points with colours in 0..1; None where there are none."""
        if not len(self.position):
            return None
        return PointCloud(self.position.astype(np.float32), self.colour.astype(np.float32) / 255)

    def subset(self, kept: Sequence[int]) -> SparseModel:
        """Return the model of some of its photographs, and the points that MIN_OBSERVATIONS of them observe.

        Args:
            kept: their indices in `posed`, ascending.
        """
        number = np.full(len(self.posed), -1, np.int32)
        number[list(kept)] = np.arange(len(kept))
        if self.has_given_cameras:  # no observation says which points these photographs show
            return replace(self, posed=[self.posed[i] for i in kept])
        observed = number[self.track_photograph] >= 0
        often = np.bincount(self.track_point[observed], minlength=len(self.position)) >= MIN_OBSERVATIONS
        observed &= often[self.track_point]
        points, track_point = np.unique(self.track_point[observed], return_inverse=True)
        return replace(
            self,
            posed=[self.posed[i] for i in kept],
            position=self.position[points],
            colour=self.colour[points],
            track_point=track_point.reshape(-1).astype(np.int32),
            track_photograph=number[self.track_photograph[observed]],
            track_pixel=self.track_pixel[observed],
        )
