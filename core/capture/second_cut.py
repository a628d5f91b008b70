# SPDX-License-Identifier: GPL-3.0-or-later
"""Second cut: the edges of captured masks decided again, once a quick fit has rendered the object in all photographs.

Its outlines agree over the views, and its colours and the support plane's texture say what a pixel at the edge shows. Gaps that the masks
fill are opened where several photographs see the background in them; false holes are filled.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import cv2
import numpy as np

from ..machine.thread_pool import run_jobs
from ..scene.dataset import Bound, View
from ..scene.surroundings import Surroundings
from .convex_cut import minimum_cut
from .edge_colours import EdgeColours, edge_colours, edge_evidence, object_evidence
from .false_holes import holes_like_object, without_false_holes
from .filled_gaps import blurred, carved_silhouettes, gaps_in
from .plane_texture import PlaneTexture, plane_texture
from .segmentation import edge_weight
from .support_plane import SupportPlane

MASK_MARGIN = 12.0  # errors of a mask around it that are looked at
COLOUR_FACTOR = 0.3  # factor of the colours' log-likelihood ratio: neighbouring pixels are not independent
MAX_COLOUR_COST = 3.0  # largest cost of that ratio, nats
# Cost of a pixel that the object does not cover at all, nats. The ratio alone takes a pixel that is mixed of both colours for the object,
# as the background's colour varies less: masks of slats and wires were .3 to .5 pixels too wide.
COVERAGE_COST = 2.0
SURE_COST = 6.0  # cost of sure pixels, nats
PRIOR_COST = 1.0  # cost of cutting against the rendered opacity, nats
EDGE_COST = 4.0  # cost of a pixel's length of silhouette where the image is flat, nats
ITERATIONS = 100  # of the cut
COVERAGE_SIGMA = 0.6  # sigma in pixels of the blur that turns a binary mask into coverage
MIN_AGREEMENT = 0.6  # IoU of both masks of a view below which the first is kept
REMAINING_ERROR = 0.5  # of the masks' error after the cut
# Mean distance, in errors of the masks, by which a cut moves their edges outward or inward, and from which it is repeated. The masks found
# of four captures move by .02 to .12; the same made 1 or 2 pixels too small or too large move by .4 to 1.1.
MAX_EDGE_SHIFT = 0.3
MAX_CUTS = 3  # cuts at most
Crop = tuple[slice, slice]  # rows and columns


def support_plane_of(surroundings: Surroundings | None) -> SupportPlane | None:
    """Return the plane Z = 0 of captured surroundings; None where the object does not stand on one."""
    if surroundings is None or not surroundings.has_ground:
        return None
    return SupportPlane(np.array([0.0, 0.0, 1.0]), 0.0, 0.0, np.empty((0, 3)))


def cut_again(views: Sequence[View], rendered: Sequence[tuple[np.ndarray, np.ndarray]], plane: SupportPlane, bound: Bound) -> list[View]:
    """Return the views with masks whose edges agree with the photographs and with the rendered object; their error is smaller.

    Args:
        views: views with masks and the masks' error.
        rendered: for each view, the object's straight colour (H, W, 3), encoded, and its opacity (H, W).
        plane: plane that the object stands on.
        bound: sphere about the object.
    """
    texture = plane_texture([view.colour for view in views], [view.camera for view in views], [view.alpha for view in views], plane, bound)
    crops = [_crop(view) for view in views]
    parts = [(image[crop], opacity[crop]) for (image, opacity), crop in zip(rendered, crops, strict=True)]
    colours = _all_colours(texture, views, crops, parts)
    whole = without_false_holes(views, _holes(views, crops, colours), bound, plane)
    if any(one is not before for one, before in zip(whole, views, strict=True)):
        colours = _all_colours(texture, whole, crops, parts)
    evidence = edge_evidence(colours)
    opacity = [part[1] for part in parts]
    colours, opacity = _without_gaps(whole, crops, colours, evidence, opacity, plane, bound)
    return list(run_jobs(_with_mask, list(zip(whole, crops, colours, evidence, opacity, strict=True))))


def _all_colours(
    texture: PlaneTexture, views: Sequence[View], crops: Sequence[Crop], rendered: Sequence[tuple[np.ndarray, np.ndarray]]
) -> list[EdgeColours]:
    """Return the colours in the crops of all views; `rendered` is cropped."""
    return list(run_jobs(_colours, [(texture, *parts) for parts in zip(views, crops, rendered, strict=True)]))


def _holes(views: Sequence[View], crops: Sequence[Crop], colours: Sequence[EdgeColours]) -> list[np.ndarray]:
    """Return the numbers (H, W) of the holes in each view's mask that may be false."""
    found = []
    for view, crop, one, evidence in zip(views, crops, colours, object_evidence(colours), strict=True):
        assert view.alpha is not None
        numbers = np.zeros(view.alpha.shape, np.int32)
        numbers[crop] = holes_like_object(view.alpha[crop], evidence, one.textured)
        found.append(numbers)
    return found


def _without_gaps(
    views: Sequence[View],
    crops: Sequence[Crop],
    colours: Sequence[EdgeColours],
    evidence: Sequence[np.ndarray],
    opacity: Sequence[np.ndarray],
    plane: SupportPlane,
    bound: Bound,
) -> tuple[list[EdgeColours], list[np.ndarray]]:
    """Return colours and opacities (h, w) of all crops in which the gaps that masks fill are neither surely the object, nor opaque."""
    doubts = [blurred(ratio, view.mask_error) for view, ratio in zip(views, evidence, strict=True)]
    masks = [np.zeros((view.camera.height, view.camera.width), bool) for view in views]
    for view, crop, doubt, mask in zip(views, crops, doubts, masks, strict=True):
        assert view.alpha is not None
        mask[crop] = (doubt < 0) & (view.alpha[crop] > 0.5)
    found = carved_silhouettes([view.camera for view in views], masks, bound, plane)
    if found is None:
        return list(colours), list(opacity)
    shown = [silhouette[crop] for silhouette, crop in zip(found, crops, strict=True)]
    gaps = [gaps_in(one.inside, *pair) for one, *pair in zip(colours, doubts, shown, strict=True)]
    opened = [replace(one, inside=one.inside & ~gap) for one, gap in zip(colours, gaps, strict=True)]
    return opened, [np.where(gap, np.minimum(one, seen), one) for gap, one, seen in zip(gaps, opacity, shown, strict=True)]


def edges_settled(before: Sequence[View], after: Sequence[View]) -> bool:
    """Return True where a cut moved the edges of masks so little that another one would not improve them.

    Args:
        before: views before the cut, with the masks' error.
        after: the same views after it.
    """
    shifts = [_edge_shift(*pair) / max(pair[0].mask_error, 1e-9) for pair in zip(before, after, strict=True)]
    return abs(float(np.mean(shifts))) <= MAX_EDGE_SHIFT


def _edge_shift(before: View, after: View) -> float:
    """Return the mean distance in pixels by which a mask's edge moved outward; 0 for an empty mask."""
    assert before.alpha is not None and after.alpha is not None
    filled = before.alpha > 0.5
    length = np.pi / 4 * sum(np.count_nonzero(np.diff(filled, axis=axis)) for axis in (0, 1))  # of an edge in all directions alike
    return float((after.alpha - before.alpha).sum() / length) if length else 0.0


def _crop(view: View) -> Crop:
    """Return rows and columns around a view's mask; all where it is empty."""
    assert view.alpha is not None
    filled, margin = view.alpha > 0.5, round(MASK_MARGIN * view.mask_error)
    if not filled.any():
        return slice(None), slice(None)
    places = (np.flatnonzero(filled.any(axis)) for axis in (1, 0))
    rows, columns = (slice(max(int(place[0]) - margin, 0), int(place[-1]) + 1 + margin) for place in places)
    return rows, columns


def _colours(texture: PlaneTexture, view: View, crop: Crop, part: tuple[np.ndarray, np.ndarray]) -> EdgeColours:
    assert view.alpha is not None
    alpha = view.alpha[crop]
    camera = view.camera.cropped(crop[1].start or 0, crop[0].start or 0, alpha.shape[1], alpha.shape[0])
    return edge_colours(texture, np.clip(view.colour[crop], 0, 1), camera, alpha, part, view.mask_error)


def _with_mask(view: View, crop: Crop, colours: EdgeColours, evidence: np.ndarray, opacity: np.ndarray) -> View:
    """Cut a view; a mask that changes too much is kept as it was."""
    assert view.alpha is not None
    cost = np.clip(COLOUR_FACTOR * evidence, -MAX_COLOUR_COST, MAX_COLOUR_COST) + PRIOR_COST * (1 - 2 * opacity)
    cost += COVERAGE_COST * colours.reliability * (1 - 2 * colours.coverage)
    cost = np.where(colours.inside, -SURE_COST, np.where(colours.outside, SURE_COST, cost)).astype(np.float32)
    weight = edge_weight(np.ascontiguousarray(np.clip(view.colour[crop], 0, 1)), EDGE_COST)
    binary = (minimum_cut(cost, weight, opacity, ITERATIONS) > 0.5).astype(np.float32)
    alpha = np.zeros_like(view.alpha)
    alpha[crop] = cv2.GaussianBlur(binary, (0, 0), COVERAGE_SIGMA)
    both = np.minimum(alpha, view.alpha).sum(), np.maximum(alpha, view.alpha).sum()
    if both[0] <= MIN_AGREEMENT * both[1]:
        return view
    return replace(view, alpha=alpha, mask_error=REMAINING_ERROR * view.mask_error, cut_by_colours=True)
