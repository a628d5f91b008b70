# SPDX-License-Identifier: GPL-3.0-or-later
"""Dense points of a capture: quick depth maps at a low resolution, and the oriented points fused from them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from ..datasets.bound import bound_of_cameras, bound_of_points, find_look_at_point
from ..io.image import DecodedImage, reduce_image
from ..progress.protocol import Progress, Silent
from ..scene.dataset import Bound, PointCloud, View
from ..stereo.depth_bounds import depth_bounds
from ..stereo.depth_map import DepthMap
from ..stereo.estimation import estimate_depth_maps
from ..stereo.fusion import OrientedPoints, fuse_points
from ..stereo.settings import StereoSettings

MAX_DEPTH_MAP_SIDE = 320  # longest side of a depth map, pixels
MAX_VIEWS = 64  # most views with a depth map: more add time but hardly any surface
MIN_SUPPORT = 2  # views that must agree with a depth
# A third of the time: the depths only have to tell parts apart. Exposures are not known yet.
QUICK = StereoSettings(sources=5, fine_sweeps=1, geometric_sweeps=0, brightness=0.0)


@dataclass(frozen=True, eq=False)
class DensePoints:
    """Surfaces of the scene as stereo sees them.

    Attributes:
        chosen: indices of the views that have a depth map.
        maps: their depth maps; a depth counts where its support is at least MIN_SUPPORT.
        points: fused points.
        target: (3,) the point that the cameras look at, or the centre that the user gave.
        distance: median distance of the cameras to it, world units.
        pixel: size of a depth map's pixel at that distance, world units: about the noise of the points.
        reliable: the cameras do look at one point, or the user gave it.
    """

    chosen: list[int]
    maps: list[DepthMap]
    points: OrientedPoints
    target: np.ndarray
    distance: float
    pixel: float
    reliable: bool


def find_dense_points(views: Sequence[View], points: PointCloud | None, sphere: Bound | None, seed: int, progress: Progress) -> DensePoints:
    """Estimate quick depth maps and fuse them.

    Args:
        views: undistorted photographs, two or more.
        points: sparse points, or None.
        sphere: bounding sphere of the object, if the user gave it.
        seed: seed of stereo's random numbers.
        progress: receives the phase "dense points", and may cancel.

    Raises:
        Cancelled: the user stopped the work.
    """
    chosen = np.unique(np.linspace(0, len(views) - 1, min(len(views), MAX_VIEWS)).round().astype(int)).tolist()
    small = [_reduced(views[i]) for i in chosen]
    cameras = [view.camera for view in small]
    known = None if points is None or not len(points.position) else points.position.astype(np.float64)
    bound = sphere or (bound_of_points(cameras, known) if known is not None else None) or bound_of_cameras(cameras)
    nearest, farthest = depth_bounds(cameras, points, bound)
    maps = estimate_depth_maps(small, nearest, farthest, known, QUICK, seed, _Renamed(progress))
    fused = fuse_points(maps, [view.colour for view in small], MIN_SUPPORT, QUICK)
    look = find_look_at_point(cameras)
    target = look.point if sphere is None else np.asarray(sphere.centre, np.float64)
    distance = float(np.median([np.linalg.norm(camera.centre - target) for camera in cameras]))
    pixel = distance / float(np.median([camera.fx for camera in cameras]))
    return DensePoints(chosen, maps, fused, target, distance, pixel, look.reliable or sphere is not None)


def _reduced(view: View) -> View:
    """Return a view with an image of at most MAX_DEPTH_MAP_SIDE pixels a side and without alpha."""
    scale = min(1.0, MAX_DEPTH_MAP_SIDE / max(view.camera.width, view.camera.height))
    width, height = (max(1, round(scale * side)) for side in (view.camera.width, view.camera.height))
    colour = reduce_image(DecodedImage(view.colour, None), width, height).colour
    return replace(view, camera=view.camera.resized(width, height), colour=colour, alpha=None)


class _Renamed(Silent):
    """Progress of stereo, whose phase is called "dense points"."""

    def __init__(self, progress: Progress) -> None:
        self._progress = progress

    @property
    def cancelled(self) -> bool:  # pyright: ignore[reportIncompatibleVariableOverride]
        return self._progress.cancelled

    def phase(self, name: str, steps: int) -> None:
        self._progress.phase("dense points", steps)

    def step(self, done: int, **metrics: float) -> None:
        self._progress.step(done, **metrics)

    def message(self, text: str) -> None:
        self._progress.message(text)
