# SPDX-License-Identifier: GPL-3.0-or-later
"""Segmentation of single views: seeds from the depth maps, colours of the object and its surroundings, and a minimum cut."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from ..scene.camera import Camera
from ..scene.dataset import Bound, View
from ..stereo.depth_map import DepthMap
from .colour_model import ColourModel, count_colours, lab_bins, probabilities
from .convex_cut import minimum_cut
from .dense_points import MIN_SUPPORT
from .ground import Ground
from .object_region import ObjectRegion

MARGIN = 1.15  # factor of the bound's radius in the crop
SEED_WINDOW = 3  # pixels of a depth map's window in which all depths must agree for a seed
SEED_COST = 4.0  # cost of cutting against a seed, nats
GIVEN_COST = 4.0  # cost of cutting against the user's mask, nats
LOOSE_EDGE = 8.0  # pixels around the edge of the user's mask over which this cost grows: drawn edges are not exact
COLOUR_FACTOR = 0.6  # factor of the colours' log-likelihood ratio: neighbouring pixels are not independent
MAX_COLOUR_RATIO = 2.5  # largest log-likelihood ratio of a colour
PLANE_FACTOR = 0.6  # factor of the log-likelihood ratio of the support plane's texture
# COLOUR_FACTOR where that texture is known, which tells object and table apart even where their colours are alike.
COLOUR_FACTOR_WITH_PLANE = 0.2
SHARED_WEIGHT = 0.5  # weight of the colours of all views against those of the view itself
PRIOR_COST = 2.5  # cost of cutting against the other views, nats
INSIDE_FACTOR = 0.4  # factor of it inside their silhouette: a visual hull fills hollows, so that it tells more of the outside
NEAR_PIXELS = 12.0  # pixels around the object's silhouette from which the background's colours are learned, at 640 pixels a side
EDGE_COST = 2.5  # cost of a pixel's length of silhouette where the image is flat
MIN_EDGE_FRACTION = 0.1  # fraction of EDGE_COST that a pixel's length of silhouette costs at the strongest edges of the image
ITERATIONS = 150  # of the cut


@dataclass(frozen=True, eq=False)
class Cutout:
    """Part of a view in which the object is cut out; all images are (h, w) of the crop.

    Attributes:
        box: first column, first row, end of the columns, end of the rows.
        colour: (h, w, 3) float32 sRGB.
        bins: (h, w) int32 bins of the colours (see `colour_model`).
        seed: int8, 1 where stereo sees the object, -1 where it sees something else or where the object can't be, 0 elsewhere.
        weight: float32 cost of a pixel's length of silhouette.
        given: float32 -1..1, how surely the user's mask says that a pixel is the object; None without.
    """

    box: tuple[int, int, int, int]
    colour: np.ndarray
    bins: np.ndarray
    seed: np.ndarray
    weight: np.ndarray
    given: np.ndarray | None = None

    def full(self, crop: np.ndarray, shape: tuple[int, int]) -> np.ndarray:
        """Return the image (H, W) float32 of the whole view that is 0 outside the crop."""
        image = np.zeros(shape, np.float32)
        image[self.box[1] : self.box[3], self.box[0] : self.box[2]] = crop
        return image

    def cropped(self, image: np.ndarray) -> np.ndarray:
        """Return the crop of an image (H, W, ...) of the whole view."""
        return image[self.box[1] : self.box[3], self.box[0] : self.box[2]]


def prepare_cutout(
    view: View,
    depth_map: DepthMap | None,
    region: ObjectRegion,
    ground: Ground | None,
    given: np.ndarray | None = None,
    background: np.ndarray | None = None,
) -> Cutout | None:
    """Crop a view around the object and set its seeds.

    Args:
        view: the photograph.
        depth_map: depth map of the view, at any resolution; None without.
        region: region of the object.
        ground: ground on which the object stands, or None.
        given: (H, W) 0..1 mask that the user gave, or None.
        background: (H, W) bool, True where a static background is seen, or None.

    Returns:
        The crop, None where the view does not show the object's bound.
    """
    box = _box(view.camera, region.bound)
    if box is None:
        return None
    left, top, right, bottom = box
    crop, cropped = (slice(top, bottom), slice(left, right)), view.camera.cropped(left, top, right - left, bottom - top)
    seed = np.where(_sphere_mask(cropped, region.bound), 0, -1).astype(np.int8)
    if depth_map is not None:
        found = _depth_seeds(depth_map, region, ground)
        found = cv2.resize(found, (view.camera.width, view.camera.height), interpolation=cv2.INTER_NEAREST)[crop]
        seed = np.where(seed == 0, found, seed)
    if background is not None:
        seed = np.where(background[crop], -1, seed).astype(np.int8)
    colour = np.ascontiguousarray(view.colour[crop])
    sure = None if given is None else _sureness(given)[crop]
    return Cutout(box, colour, lab_bins(colour), seed, edge_weight(colour), sure)


def _sureness(mask: np.ndarray) -> np.ndarray:
    """Return (H, W) float32 -1..1 for the user's mask, 0 at its edge."""
    inside = (mask >= 0.5).astype(np.uint8)
    distance = cv2.distanceTransform(inside, cv2.DIST_L2, 3) - cv2.distanceTransform(1 - inside, cv2.DIST_L2, 3)
    return np.clip(distance / LOOSE_EDGE, -1, 1).astype(np.float32)


def _box(camera: Camera, bound: Bound) -> tuple[int, int, int, int] | None:
    """Return the part of the image around a sphere; None where it is outside or the camera is inside the sphere."""
    pixel, depth = camera.project(np.asarray(bound.centre)[None])
    if depth[0] <= bound.radius:
        return None
    x, y = pixel[0]
    reach = MARGIN * bound.radius / np.sqrt(depth[0] ** 2 - bound.radius**2)
    left, right = max(int(x - reach * camera.fx), 0), min(int(np.ceil(x + reach * camera.fx)), camera.width)
    top, bottom = max(int(y - reach * camera.fy), 0), min(int(np.ceil(y + reach * camera.fy)), camera.height)
    return (left, top, right, bottom) if right - left >= 8 and bottom - top >= 8 else None


def _sphere_mask(camera: Camera, bound: Bound) -> np.ndarray:
    """Return (H, W) True where a pixel's ray meets a sphere."""
    rays = camera.rays()
    to = (np.asarray(bound.centre) - camera.centre).astype(np.float32)
    along = rays @ to
    return (along > 0) & (along**2 >= (rays * rays).sum(-1) * np.float32(to @ to - bound.radius**2))


def _depth_seeds(one: DepthMap, region: ObjectRegion, ground: Ground | None) -> np.ndarray:
    """Return seeds (h, w) int8 at the depth map's resolution; the end of a thin leg, near the plane, is neither."""
    known = one.support >= MIN_SUPPORT
    points = one.points()
    own, other = known & (region.labels(points) == 1), known
    if ground is not None:
        own &= ~ground.below(points)
        other = known & ~(region.near(points) & ground.may_be_foot(points))
    window = np.ones((SEED_WINDOW, SEED_WINDOW), np.uint8)
    inner = cv2.erode((own | ~known).astype(np.uint8), window) * own
    outer = cv2.erode((~own).astype(np.uint8), window) * (other & ~own)
    return inner.astype(np.int8) - outer.astype(np.int8)


def edge_weight(colour: np.ndarray, most: float = EDGE_COST) -> np.ndarray:
    """Return the cost (h, w) of a pixel's length of silhouette: less where colours change.

    Args:
        colour: (h, w, 3) float32 sRGB.
        most: the cost where the image is flat.
    """
    lab = cv2.cvtColor(colour, cv2.COLOR_RGB2LAB)
    change = np.zeros(lab.shape[:2], np.float32)
    change[:, :-1] += (np.diff(lab, axis=1) ** 2).sum(-1)
    change[:-1] += (np.diff(lab, axis=0) ** 2).sum(-1)
    return most * (MIN_EDGE_FRACTION + (1 - MIN_EDGE_FRACTION) * np.exp(-change / (2 * change.mean() + 1e-6))).astype(np.float32)


def learn_colours(cutouts: Sequence[Cutout], inside: Sequence[np.ndarray], beyond: Sequence[np.ndarray], near: float) -> list[ColourModel]:
    """Count the colours of the object and of its surroundings in every view, mixed with those of all views.

    Args:
        cutouts: the views.
        inside: (h, w) -1..1 of each, how surely a pixel is the object (1) or the background (-1).
        beyond: (h, w) bool of each, where the support plane can't be the background, see `beyond_plane`.
        near: pixels around the object from which the background's colours count.
    """
    counts = []
    for cutout, sure, elsewhere in zip(cutouts, inside, beyond, strict=True):
        far = np.minimum(cv2.distanceTransform((sure <= 0).astype(np.uint8), cv2.DIST_L2, 3), 1e4)  # huge where nothing is the object
        weight = np.maximum(-sure, 0) / (1 + (far / near) ** 2)
        counts.append([count_colours(cutout.bins, one) for one in (np.maximum(sure, 0), weight, weight * elsewhere)])
    shared = [np.mean([c[k] / max(c[k].sum(), 1) for c in counts], 0) for k in range(3)]
    return [ColourModel(*(_mixed(*pair) for pair in zip(own, shared, strict=True))) for own in counts]


def _mixed(own: np.ndarray, shared: np.ndarray) -> np.ndarray:
    """Return probabilities (B,) of colours from a view's own counts (B,) and the shares (B,) in all views."""
    return probabilities(SHARED_WEIGHT * shared + (1 - SHARED_WEIGHT) * own / own.sum() if own.sum() > 0 else shared)


def cut(
    cutout: Cutout,
    model: ColourModel,
    beyond: np.ndarray,
    prior: np.ndarray,
    seed_cost: float,
    start: np.ndarray,
    plane: np.ndarray | None = None,
) -> np.ndarray:
    """Cut the object out of a view.

    Args:
        cutout: the view.
        model: colours of the object and of the background.
        beyond: (h, w) bool, where the support plane can't be the background.
        prior: (h, w) 0..1, how surely other evidence says that a pixel is the object.
        seed_cost: cost of cutting against a seed, nats.
        start: (h, w) 0..1 where the iterations begin.
        plane: (h, w) log-likelihood ratio of the support plane to the object (`background_evidence`), 0 where unknown; None without.

    Returns:
        The mask (h, w) float32, nearly binary.
    """
    ratios = [np.log(background / model.object).astype(np.float32)[cutout.bins] for background in (model.background, model.beyond)]
    cost = COLOUR_FACTOR * np.clip(np.where(beyond, ratios[1], ratios[0]), -MAX_COLOUR_RATIO, MAX_COLOUR_RATIO)
    if plane is not None:
        cost = np.where(plane != 0, COLOUR_FACTOR_WITH_PLANE / COLOUR_FACTOR, 1) * cost + PLANE_FACTOR * plane
    cost = (cost - seed_cost * cutout.seed).astype(np.float32)
    cost += PRIOR_COST * np.where(prior > 0.5, INSIDE_FACTOR, 1) * (1 - 2 * prior)
    if cutout.given is not None:
        cost -= GIVEN_COST * cutout.given
    return minimum_cut(cost, cutout.weight, start, ITERATIONS)
