# SPDX-License-Identifier: GPL-3.0-or-later
"""Masks that agree over the views: cut in each view, carve a soft hull from all, and cut again with its silhouettes as a prior."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np

from ..errors import Cancelled
from ..machine.thread_pool import run_jobs
from ..progress.protocol import Progress
from ..scene.camera import Camera
from .background_evidence import background_evidence, beyond_plane, plane_differences
from .ground import Ground
from .object_region import ObjectRegion
from .plane_texture import PlaneTexture, plane_texture
from .segmentation import LOOSE_EDGE, NEAR_PIXELS, SEED_COST, Cutout, cut, learn_colours
from .soft_hull import projected_voxels, silhouettes, soft_hull
from .trusted_silhouettes import trusted_silhouettes

# Rounds of carving and cutting again: until the masks of two rounds agree, by their mean IoU. The IoU with the true masks rises from .925
# after 2 to .943 after 5 on a chair of rods, from .982 to .989 after 3 on a white mug.
MIN_ROUNDS, MAX_ROUNDS, SETTLED_OVERLAP = 2, 6, 0.99
LATER_SEED_COST = 1.0  # cost of cutting against a seed in them: the other views know more than single depths
PRIOR_FALLOFF = 0.15  # radii of the bound beside the object's points over which the first prior falls to 0
OBJECT_PRIOR = 0.87  # first prior where the object's points are
FOOT_PRIOR = 0.5  # smallest first prior where the object's foot may be
HIDING_PRIOR = 0.3  # first prior from which a pixel may hide the support plane
# Pixels at 640 a side, sigma of the blur of the evidence for the plane in the first cut. That for the object stays, so that rods do.
EVIDENCE_BLUR = 1.5
GAP_DIAMETER = 7  # pixels at 640 a side, diameter of gaps in the first masks that are closed
ELSEWHERE_SURENESS = 0.7  # how surely pixels that stereo does not see, away from the points, count as background colours
MIN_AGREEMENT = 0.6  # IoU with the other views' silhouette below which a mask has no vote
SURE_AGREEMENT = 0.75  # IoU below which a finished mask is reported


@dataclass(frozen=True, eq=False)
class MaskedView:
    """View of which the object is cut out.

    Attributes:
        name: name of the view.
        camera: its camera.
        colour: (H, W, 3) float32 sRGB-encoded photograph.
        cutout: crop with its seeds; None for a view that does not show the object.
        mapped: True for a view with a depth map: the others are cut once the hull is known.
    """

    name: str
    camera: Camera
    colour: np.ndarray
    cutout: Cutout | None
    mapped: bool


@dataclass(frozen=True, eq=False)
class _CutInput:
    """What the cut of one view starts from; images are (h, w) of its crop.

    Attributes:
        view: index of the view.
        prior: 0..1, how surely other views and the object's points say that a pixel is the object.
        sure: -1..1, how surely a pixel's colour is the object's (1) or the background's (-1).
        seed_cost: cost of cutting against a seed, nats.
        start: 0..1 where the iterations begin.
        evidence: log-likelihood ratio of the support plane to the object; None without.
    """

    view: int
    prior: np.ndarray
    sure: np.ndarray
    seed_cost: float
    start: np.ndarray
    evidence: np.ndarray | None


def consistent_masks(
    views: Sequence[MaskedView], region: ObjectRegion, ground: Ground | None, progress: Progress, widening: float = 0.0
) -> tuple[list[np.ndarray | None], list[tuple[str, str]]]:
    """Cut the object out of all views.

    Args:
        views: the views.
        region: region of the object.
        ground: ground on which the object stands, or None.
        progress: receives the phase "cut out the object", and may cancel.
        widening: pixels at 640 a side by which the masks may be wrong.

    Returns:
        A mask (H, W) of each view, nearly binary, None where there is none, and the names of doubtful views with the reason.

    Raises:
        Cancelled: the user stopped the work.
    """
    work = _Work(views, region, ground, progress, widening)
    work.run()
    return work.masks, work.doubtful()


class _Work:
    """State of the rounds; see `consistent_masks` for the arguments."""

    def __init__(
        self, views: Sequence[MaskedView], region: ObjectRegion, ground: Ground | None, progress: Progress, widening: float
    ) -> None:
        self.views, self.cutouts, self.cameras = views, [one.cutout for one in views], [one.camera for one in views]
        self.region, self.ground, self.progress, self.widening = region, ground, progress, widening
        self.masks: list[np.ndarray | None] = [None] * len(views)
        self.agreement = np.ones(len(views))
        self.refused: set[int] = set()
        self.texture: PlaneTexture | None = None
        self.pixel = float(np.median([max(camera.width, camera.height) for camera in self.cameras])) / 640
        self.done = 0

    def run(self) -> None:
        """Cut all views, and again until the masks settle."""
        self._begin((MIN_ROUNDS + 1) * len(self.views))
        self.first([i for i, one in enumerate(self.views) if one.cutout is not None and (one.mapped or one.cutout.given is not None)])
        for done in range(MAX_ROUNDS):
            if done >= MIN_ROUNDS:
                self._begin(len(self.views))
            before = list(self.masks)
            self.again()
            if done + 1 >= MIN_ROUNDS and _mean_overlap(before, self.masks) >= SETTLED_OVERLAP:
                return

    def _begin(self, steps: int) -> None:
        self.progress.phase("cut out the object", steps)
        self.done = 0

    def first(self, chosen: list[int]) -> None:
        """Cut the chosen views, which have evidence of their own, with the object's points as a weak prior.

        Metal reflects the table: here and there it looks like the plane behind it. Such speckles would become holes, which carve the hull.
        """
        if not chosen:
            return
        whole = [self._first_prior(camera) for camera in self.cameras]
        priors = [self._cutout(i).cropped(whole[i]) for i in chosen]
        sure = [_first_sureness(self._cutout(i), prior) for i, prior in zip(chosen, priors, strict=True)]
        evidence = self._first_evidence(chosen, sure, whole)
        parts = zip(chosen, priors, sure, evidence, strict=True)
        self._cut([_CutInput(i, prior, one, SEED_COST, np.maximum(one, 0), plane) for i, prior, one, plane in parts])
        side = 2 * round((GAP_DIAMETER * self.pixel - 1) / 2) + 1  # odd
        for i in chosen:
            mask = self.masks[i]
            assert mask is not None
            self.masks[i] = cv2.morphologyEx(mask, cv2.MORPH_CLOSE, cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (side, side)))

    def _first_evidence(self, chosen: list[int], sure: list[np.ndarray], whole: list[np.ndarray]) -> list[np.ndarray | None]:
        """Return the evidence of the plane (h, w) in the chosen views before any view was cut; None where no point tells what hides it.

        Args:
            chosen: the views.
            sure: (h, w) -1..1 of each chosen view, as of `_first_sureness`.
            whole: first prior (H, W) of all views.
        """
        if not len(self.region.points()):
            return [None] * len(chosen)
        known = [np.select([one > 0.9, one < -0.5], [1.0, 0.0], 0.5).astype(np.float32) for one in sure]  # object, background, either
        found = self._plane_evidence(chosen, known, [(prior > HIDING_PRIOR).astype(np.float32) for prior in whole])
        return [None if one is None else np.minimum(one, cv2.GaussianBlur(one, (0, 0), EVIDENCE_BLUR * self.pixel)) for one in found]

    def again(self) -> None:
        """Carve the hull from all masks, and cut every view with the silhouette that the other views give."""
        plane = None if self.ground is None else self.ground.plane
        weights = (self.agreement >= MIN_AGREEMENT).astype(float)
        hull = soft_hull(self.cameras, self.masks, weights, self.region.bound, plane, self.widening * self.pixel)
        if hull is None:
            return
        found = silhouettes(hull, self.cameras)
        self._compare(found)
        chosen = [i for i, cutout in enumerate(self.cutouts) if cutout is not None]
        near = [self._cutout(i).cropped(self._first_prior(self.cameras[i])) / OBJECT_PRIOR for i in chosen]
        priors = trusted_silhouettes([self._cutout(i).cropped(found[i]) for i in chosen], near)
        costs = [LATER_SEED_COST if self.agreement[i] >= MIN_AGREEMENT else 0.0 for i in chosen]
        parts = zip(chosen, priors, costs, self._plane_evidence(chosen, priors, self.masks), strict=True)
        self._cut([_CutInput(i, prior, 2 * prior - 1, cost, prior, plane) for i, prior, cost, plane in parts])
        self._compare(found)

    def doubtful(self) -> list[tuple[str, str]]:
        """Return the names of doubtful views with the reason."""
        found = []
        for i, (view, mask) in enumerate(zip(self.views, self.masks, strict=True)):
            if self.cutouts[i] is None:
                found.append((view.name, "does not show the object"))
            elif mask is None or mask.max() < 0.5:
                found.append((view.name, "the object was not found in it"))
            elif i in self.refused:
                found.append((view.name, "the mask that was given contradicts the other views; it was cut out anew"))
            elif self.agreement[i] < SURE_AGREEMENT:
                found.append((view.name, f"its mask and the other views' agree only by {100 * self.agreement[i]:.0f} %"))
        return found

    def _cutout(self, i: int) -> Cutout:
        cutout = self.cutouts[i]
        assert cutout is not None
        return cutout

    def _first_prior(self, camera: Camera) -> np.ndarray:
        """Return the prior (H, W) from the object's points: OBJECT_PRIOR at them, 0 away from them, FOOT_PRIOR where a foot may be."""
        points, bound = self.region.points(), self.region.bound
        if not len(points):
            return np.full((camera.height, camera.width), 0.5, np.float32)
        on = projected_voxels(camera, points, self.region.step) > 0
        radius = bound.radius * camera.fx / max(float(camera.project(np.asarray(bound.centre)[None])[1][0]), 1e-9)
        distance = cv2.distanceTransform((~on).astype(np.uint8), cv2.DIST_L2, 5)
        prior = np.where(on, OBJECT_PRIOR, 0.5 * np.clip(1 - distance / max(PRIOR_FALLOFF * radius, 1), 0, 1)).astype(np.float32)
        foot = projected_voxels(camera, self.region.foot, self.region.step) > 0
        return np.where(foot, np.maximum(prior, np.float32(FOOT_PRIOR)), prior)

    def _plane_evidence(
        self, chosen: list[int], priors: list[np.ndarray], hidden: Sequence[np.ndarray | None]
    ) -> Sequence[np.ndarray | None]:
        """Return the evidence (h, w) that pixels of the chosen views show the support plane; None for each without a plane.

        The first call makes the plane's texture, where `hidden` (H, W) of each view is 0.
        """
        if self.ground is None:
            return [None] * len(chosen)
        if self.texture is None:
            on_object = [self._seen_object(i) for i in range(len(self.cutouts))]
            seen = plane_texture([one.colour for one in self.views], self.cameras, hidden, self.ground.plane, self.region.bound, on_object)
            self.texture = self.ground.visible(seen)
        jobs = []
        for i, prior in zip(chosen, priors, strict=True):
            jobs.append((self.texture, self._cutout(i).colour, self._cropped_camera(i), prior))
        return background_evidence(list(run_jobs(plane_differences, jobs)), priors)

    def _seen_object(self, i: int) -> np.ndarray | None:
        """Return (H, W) float32, 1 where stereo sees the object in a view, else 0; None where it says nothing."""
        cutout, camera = self.cutouts[i], self.cameras[i]
        if cutout is None or not (cutout.seed > 0).any():
            return None
        return cutout.full(cutout.seed > 0, (camera.height, camera.width))

    def _cut(self, inputs: Sequence[_CutInput]) -> None:
        """Learn the colours of views and cut them."""
        cutouts = [self._cutout(one.view) for one in inputs]
        beyond = list(run_jobs(self._beyond, [(one,) for one in inputs]))
        models = learn_colours(cutouts, [one.sure for one in inputs], beyond, NEAR_PIXELS * self.pixel)
        parts = zip(inputs, cutouts, models, beyond, strict=True)
        jobs = [(cutout, model, far, one.prior, one.seed_cost, one.start, one.evidence) for one, cutout, model, far in parts]
        for one, cutout, crop in zip(inputs, cutouts, run_jobs(cut, jobs), strict=False):
            camera = self.cameras[one.view]
            self.masks[one.view] = cutout.full(crop, (camera.height, camera.width))
            self.done += 1
            self.progress.step(self.done)
            if self.progress.cancelled:
                raise Cancelled("stopped while the object was cut out")

    def _beyond(self, one: _CutInput) -> np.ndarray:
        """Return where the support plane can't be the background of a cut, (h, w) bool; nowhere without a plane."""
        if self.ground is None or one.evidence is None:
            return np.zeros(one.prior.shape, bool)
        return beyond_plane(one.evidence, self._cropped_camera(one.view), self.ground.plane, self.region.bound)

    def _cropped_camera(self, i: int) -> Camera:
        left, top, right, bottom = self._cutout(i).box
        return self.cameras[i].cropped(left, top, right - left, bottom - top)

    def _compare(self, found: list[np.ndarray]) -> None:
        """Compare masks with the other views' silhouettes (H, W); a mask of the user's that contradicts them is dropped."""
        for i, (mask, other) in enumerate(zip(self.masks, found, strict=True)):
            self.agreement[i] = 1.0 if mask is None else overlap(mask, other)
            cutout = self.cutouts[i]
            if cutout is not None and cutout.given is not None and self.agreement[i] < MIN_AGREEMENT:
                self.cutouts[i] = replace(cutout, given=None)
                self.refused.add(i)


def _first_sureness(cutout: Cutout, prior: np.ndarray) -> np.ndarray:
    """Return (h, w) float32 -1..1, how surely pixels are the object before any view was cut."""
    if cutout.given is not None:
        return np.clip(cutout.given * LOOSE_EDGE / 4, -1, 1)
    return np.where(cutout.seed != 0, cutout.seed, np.where(prior < 0.35, -ELSEWHERE_SURENESS, 0)).astype(np.float32)


def _mean_overlap(masks: Sequence[np.ndarray | None], others: Sequence[np.ndarray | None]) -> float:
    """Return the mean intersection over union of masks (H, W) and others of the same views; 1 where there are none."""
    found = [overlap(one, other) for one, other in zip(masks, others, strict=True) if one is not None and other is not None]
    return float(np.mean(found)) if found else 1.0


def overlap(mask: np.ndarray, other: np.ndarray) -> float:
    """Return the intersection over union of two masks (H, W), cut at a half; 1 where both are empty."""
    a, b = mask >= 0.5, other >= 0.5
    union = int((a | b).sum())
    return int((a & b).sum()) / union if union else 1.0
