# SPDX-License-Identifier: GPL-3.0-or-later
"""Estimation of a depth map for every view: photometric PatchMatch, coarse then fine, a geometric pass, and the count of agreement."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from ..errors import Cancelled
from ..kernels.constants import WORST_COST
from ..kernels.cpu.matching_cost import Penalties, Sources
from ..machine.thread_pool import run_jobs
from ..progress.protocol import Progress
from ..scene.dataset import View
from .consistency import support
from .depth_map import DepthMap, cv_rotation
from .matching_image import MatchingImage, matching_image, pack_sources
from .patch_match import Matching, Reference, evaluate, sweep
from .planes import Bounds, Planes, finer_planes, first_planes
from .settings import StereoSettings
from .view_selection import choose_sources, choose_witnesses

FINE_STEP, GEOMETRIC_STEP = 0.25, 0.25  # of the first sweep's random changes; the coarse sweeps start with 1, and each halves it
NO_PENALTIES = Penalties(np.float32(0), np.float32(0))
MAX_PROBES = 2000  # points that tell which views see the same places
Depths = Sequence[np.ndarray | float]  # for each view, (H, W) or one for all its pixels


def estimate_depth_maps(
    views: Sequence[View],
    nearest: Depths,
    farthest: Depths,
    points: np.ndarray | None,
    settings: StereoSettings,
    seed: int,
    progress: Progress,
    initial: Sequence[np.ndarray] | None = None,
) -> list[DepthMap]:
    """Estimate depth and normals of every view, one view to a thread; equal for any number of threads.

    A pixel is searched where 0 < nearest < farthest, and where the view's alpha, if it has one, is at least 0.5. A view that shares no
    points with others gets an empty depth map.

    Args:
        views: photographs with their cameras.
        nearest: lower bound of the planar depth of each view, (H, W) or a number; 0 leaves a pixel out.
        farthest: upper bound of the planar depth of each view, (H, W) or a number.
        points: (P, 3) sparse points in the world near which three quarters of the pixels start, or None.
        settings: settings of stereo.
        seed: seed of the random numbers.
        progress: receives the phase "stereo" with a step for every view and pass, and may cancel between views.
        initial: depths (H, W) of each view near which half of the pixels start, 0 where unknown; None for none.

    Raises:
        Cancelled: the user stopped the work.
    """
    images = [matching_image(view) for view in views]
    guesses = [None] * len(views) if initial is None else list(initial)
    bounds = [_bounds(*one) for one in zip(images, nearest, farthest, guesses, strict=True)]
    search = _Search.prepare(images, bounds, points, settings, seed)
    for view, sources in zip(views, search.sources, strict=True):
        if not sources:
            progress.message(f"stereo: {view.name} shares no points with other views")
    passes = [search.photometric] + [search.geometric] * (settings.geometric_sweeps > 0)
    progress.phase("stereo", len(views) * len(passes))
    planes: list[Planes] = []
    for number, one_pass in enumerate(passes):
        found = []
        for one in run_jobs(one_pass, [(i, planes) for i in range(len(views))]):
            found.append(one)
            progress.step(number * len(views) + len(found))
            if progress.cancelled:
                raise Cancelled("stopped during stereo")
        planes = found
    return search.depth_maps(planes)


@dataclass(frozen=True, eq=False)
class _Search:
    """Everything that the passes over the views read.

    Attributes:
        images, halves: images of every view at full and half resolution.
        bounds: bounds of every view's depths.
        points: (P, 3) sparse points, or None.
        sources: indices of every view's sources.
        settings: settings of stereo.
        seed: seed of the random numbers.
    """

    images: list[MatchingImage]
    halves: list[MatchingImage]
    bounds: list[Bounds]
    points: np.ndarray | None
    sources: list[list[int]]
    settings: StereoSettings
    seed: int

    @classmethod
    def prepare(
        cls, images: list[MatchingImage], bounds: list[Bounds], points: np.ndarray | None, settings: StereoSettings, seed: int
    ) -> _Search:
        """Halve the images and choose the sources."""
        sources = choose_sources([image.camera for image in images], _probes(images, bounds, points, seed), settings.sources)
        return cls(images, [image.halved() for image in images], bounds, points, sources, settings, seed)

    def photometric(self, i: int, _: list[Planes]) -> Planes:
        """Search view i from random planes, by the images alone."""
        rng = np.random.default_rng([self.seed, i])
        image, half, bounds, coarse_bounds = self.images[i], self.halves[i], self.bounds[i], self.bounds[i].halved()
        planes = first_planes(half.camera, coarse_bounds, self.points, rng)
        if self.sources[i]:
            packed = pack_sources(half, [self.halves[k] for k in self.sources[i]])
            self._sweep(planes, half, coarse_bounds, packed, self.settings.coarse_sweeps, 1.0, rng)
        planes = finer_planes(image.camera, bounds, planes, half.camera, rng)
        if self.sources[i]:
            packed = pack_sources(image, [self.images[k] for k in self.sources[i]])
            self._sweep(planes, image, bounds, packed, self.settings.fine_sweeps, FINE_STEP, rng)
        return planes

    def geometric(self, i: int, found: list[Planes]) -> Planes:
        """Improve the planes of view i with the depths that the photometric pass found in its sources."""
        planes = found[i].copy()
        if self.sources[i]:
            rng = np.random.default_rng([self.seed, i, 1])
            depths = [np.where(found[k].cost < WORST_COST, found[k].depth, np.float32(0)) for k in self.sources[i]]
            packed = pack_sources(self.images[i], [self.images[k] for k in self.sources[i]], depths)
            penalty = self.settings.geometric_penalty
            self._sweep(planes, self.images[i], self.bounds[i], packed, self.settings.geometric_sweeps, GEOMETRIC_STEP, rng, penalty)
            self._evaluate(planes, self.images[i], packed, True, NO_PENALTIES)  # 1 - NCC alone
        return planes

    def _sweep(
        self,
        planes: Planes,
        image: MatchingImage,
        bounds: Bounds,
        sources: Sources,
        sweeps: int,
        step: float,
        rng: np.random.Generator,
        penalty: float = 0.0,
    ) -> None:
        """Compute the costs of planes, and improve them in `sweeps` sweeps whose random changes start with `step`."""
        penalties = Penalties(np.float32(penalty), np.float32(self.settings.brightness))
        self._evaluate(planes, image, sources, False, penalties)
        reference, matching = Reference(image.grey, image.inside, image.lens), self._matching(sources, penalties)
        for n in range(sweeps):
            seed = np.uint32(rng.integers(1, 1 << 32))
            sweep(reference, bounds.nearest, bounds.farthest, matching, planes, n % 2 == 1, np.float32(step / 2**n), seed)

    def _matching(self, sources: Sources, penalties: Penalties) -> Matching:
        """Return how planes are compared with some sources."""
        return Matching(sources, min(self.settings.best, len(sources.pose)), penalties, np.float32(1 / self.settings.sigma))

    def _evaluate(self, planes: Planes, image: MatchingImage, sources: Sources, only_chosen: bool, penalties: Penalties) -> None:
        """Compute the costs of planes among all sources, or among those chosen so far."""
        evaluate(Reference(image.grey, image.inside, image.lens), self._matching(sources, penalties), planes, only_chosen)

    def depth_maps(self, planes: list[Planes]) -> list[DepthMap]:
        """Return the depth maps of all views with the support of their witnesses."""
        witnesses = choose_witnesses(self.sources, self.settings.witnesses)
        maps = [_depth_map(image, one, own) for image, one, own in zip(self.images, planes, witnesses, strict=True)]
        jobs = [(one, [maps[k] for k in one.witnesses], self.settings) for one in maps]
        return [replace(one, support=count) for one, count in zip(maps, run_jobs(support, jobs), strict=True)]


def _bounds(image: MatchingImage, nearest: np.ndarray | float, farthest: np.ndarray | float, guess: np.ndarray | None) -> Bounds:
    """Return a view's bounds as images, 0 outside the object."""
    low, high = (np.broadcast_to(np.asarray(bound, np.float32), image.grey.shape) for bound in (nearest, farthest))
    return Bounds(np.where(image.inside, low, np.float32(0)), np.ascontiguousarray(high), guess)


def _probes(images: list[MatchingImage], bounds: list[Bounds], points: np.ndarray | None, seed: int) -> np.ndarray:
    """Return up to about MAX_PROBES points (P, 3) near the surfaces: sparse points, else points at random pixels between the bounds."""
    rng = np.random.default_rng(seed)
    if points is not None and len(points):
        return points if len(points) <= MAX_PROBES else points[rng.choice(len(points), MAX_PROBES, replace=False)]
    probes = []
    for image, one in zip(images, bounds, strict=True):
        rows, columns = np.nonzero(one.searched)
        pick = rng.integers(0, max(1, len(rows)), -(-MAX_PROBES // len(images)) if len(rows) else 0)
        rows, columns = rows[pick], columns[pick]
        low, high = one.nearest[rows, columns].astype(np.float64), one.farthest[rows, columns].astype(np.float64)
        depth = low + (high - low) * rng.random(len(rows))
        if one.guess is not None:
            depth = np.where(one.guess[rows, columns] > 0, one.guess[rows, columns], depth)
        probes.append(image.camera.centre + depth[:, None] * image.camera.rays()[rows, columns])
    return np.concatenate(probes)


def _depth_map(image: MatchingImage, planes: Planes, witnesses: tuple[int, ...]) -> DepthMap:
    """Return the depth map of planes, without support yet."""
    found = planes.cost < WORST_COST
    depth = np.where(found, planes.depth, np.float32(0))
    normal = np.where(found[..., None], planes.normal @ cv_rotation(image.camera).T, 0).astype(np.float32)
    cost = np.where(found, planes.cost, WORST_COST).astype(np.float32)
    return DepthMap(image.camera, depth, normal, cost, np.zeros(depth.shape, np.uint8), witnesses)
