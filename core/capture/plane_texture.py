# SPDX-License-Identifier: GPL-3.0-or-later
"""Texture of the support plane: what the photographs show of the table, averaged over all of them.

Cameras see the table behind the object from other sides. A pixel that shows the table's texture is not the object, even where both have
like colours.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import chain

import cv2
import numpy as np

from ..io.quantisation import eight_bits
from ..machine.thread_pool import run_jobs
from ..scene.camera import Camera
from ..scene.dataset import Bound
from .support_plane import SupportPlane

TEXTURE_REACH = 3.0  # radii of the object around it in which the texture is made
MAX_TEXTURE = 768  # texels along a side
MASK_CLEARANCE = 0.006  # distance that a texel keeps from the object's mask, in the image's longest sides
ROUNDS, GAP_ROUNDS = 2, 4  # of the robust mean, and of that of gaps, where some views see the object
MIN_AGREEING_FRACTION = 0.5  # fraction of the views of a texel in a gap that must agree
# Least contrast of the colours in a gap that shows the table. Views also agree on a plain wall of the object, whichever part of it they
# show. Walls of a watering can and a mug have .004 to .013, the tables .03 and .1.
MIN_GAP_CONTRAST = 0.02
# Largest disagreement in such a gap, and the same in multiples of the table's median: deviation between views over deviation between
# neighbouring texels. Views agree that the sole of a boot is dark, but on no pattern: 1.3 to 3 in most of it, 3 to 10 on the plain walls;
# tables with a pattern have .2 to .7, plain ones 3 to 8.
MAX_DISAGREEMENT, MAX_DISAGREEMENT_RATIO = 1.2, 1.5
WINDOW_SIGMA = 2.0  # texels, sigma of the window in which both are measured
NOISE_DIFFERENCE = 0.06  # difference, encoded, at which a view's weight in the robust mean falls to a quarter
PHOTOGRAPHS_AT_ONCE = 8  # photographs that are in memory as texels
MIN_WEIGHT = 2.0  # sum of the weights of a texel's views from which it is known
_Job = tuple[np.ndarray, np.ndarray, Camera, np.ndarray, int]
_RobustMean = tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]  # as returned by `_robust_mean`


@dataclass(frozen=True, eq=False)
class PlaneTexture:
    """Colours of the support plane.

    Attributes:
        colour: (h, w, 3) float32 sRGB-encoded.
        known: (h, w) float32, 1 where enough views agree, else 0.
        frame: (4, 3) matrix from texel coordinates (column, row, 1) to the plane's homogeneous world points.
    """

    colour: np.ndarray
    known: np.ndarray
    frame: np.ndarray

    def seen_by(self, camera: Camera) -> tuple[np.ndarray, np.ndarray]:
        """Return the texture as a camera sees it: (H, W, 3) encoded, and (H, W) bool where it is known."""
        matrix, size = _projection(camera) @ self.frame, (camera.width, camera.height)
        colour = cv2.warpPerspective(self.colour, matrix, size, flags=cv2.INTER_LINEAR)
        known = cv2.warpPerspective(self.known, matrix, size, flags=cv2.INTER_LINEAR)
        return colour, (known > 0.99) & _in_front(np.linalg.inv(matrix), camera.height, camera.width)

    def points(self) -> np.ndarray:
        """Return the world points (h, w, 3) of the texels."""
        row, column = np.indices(self.known.shape)
        return np.stack([column, row, np.ones_like(row)], -1) @ self.frame[:3].T


def plane_texture(
    colours: Sequence[np.ndarray],
    cameras: Sequence[Camera],
    masks: Sequence[np.ndarray | None],
    plane: SupportPlane,
    bound: Bound,
    on_object: Sequence[np.ndarray | None] | None = None,
) -> PlaneTexture:
    """Average what the views show of the plane around the object.

    Texels are robust means, so that things on the table, which views see at different texels, don't count.

    Args:
        colours: (H, W, 3) float32 sRGB-encoded photographs.
        cameras: cameras of the photographs.
        masks: (H, W) 0..1 of the object; photographs without are not used.
        plane: plane that the object stands on.
        bound: sphere about the object.
        on_object: (H, W) of each view, 1 where stereo sees the object, else 0; None for a view without stereo. With these, what the masks
            hide of the plane is looked for where stereo sees no object: masks fill gaps through which a shaded plane is seen.
    """
    frame, side = _frame(cameras, plane, bound)
    images = [eight_bits(colour) for colour in colours]

    def jobs(hidden: Sequence[np.ndarray | None], clear: float, frame: np.ndarray, side: int) -> list[_Job]:
        views = zip(images, hidden, cameras, strict=True)
        return [(image, _free(one, clear), camera, frame, side) for image, one, camera in views if one is not None]

    mean, weight, _, variance = _robust_mean(jobs(masks, MASK_CLEARANCE, frame, side), side, ROUNDS)
    known = weight > MIN_WEIGHT
    if on_object is not None:
        begin, width = side // 4, side - 2 * (side // 4)  # the object, and enough around it to tell each photograph's exposure
        part = (slice(begin, begin + width), slice(begin, begin + width))
        shifted = frame @ np.array([[1.0, 0, begin], [0, 1, begin], [0, 0, 1]])
        table = mean[part], known[part]
        found = _robust_mean(jobs(on_object, MASK_CLEARANCE / 2, shifted, width), width, GAP_ROUNDS, table)
        gap = _shown_through(found, known[part], _most_disagreement(*table, variance[part]))
        mean[part], known[part] = np.where(gap[..., None], found[0], mean[part]), known[part] | gap
    return PlaneTexture(mean, known.astype(np.float32), frame)


def _shown_through(found: _RobustMean, known: np.ndarray, most: float) -> np.ndarray:
    """Return the texels (h, w) bool of gaps that show the table.

    Args:
        found: what the views show where stereo sees no object.
        known: (h, w) bool, texels that no mask hides.
        most: largest disagreement of such texels, see `_disagreement`.
    """
    colour, weight, count, variance = found
    gap = ~known & (weight > MIN_WEIGHT) & (weight > MIN_AGREEING_FRACTION * count)
    return gap & (_contrast(colour, gap) > MIN_GAP_CONTRAST) & ~_without_pattern(colour, gap, variance, most)


def _most_disagreement(colour: np.ndarray, known: np.ndarray, variance: np.ndarray) -> float:
    """Return the disagreement up to which a gap can show the table, whose colours (h, w, 3) are known at some texels (h, w) bool."""
    table = _disagreement(colour, known, variance)[known]
    return max(MAX_DISAGREEMENT, MAX_DISAGREEMENT_RATIO * float(np.median(table))) if len(table) else MAX_DISAGREEMENT


def _without_pattern(colour: np.ndarray, gap: np.ndarray, variance: np.ndarray, most: float) -> np.ndarray:
    """Return the texels (h, w) bool of a gap on whose pattern views do not agree, and those beside them, whose window reaches there."""
    found = (gap & (_disagreement(colour, gap, variance) > most)).astype(np.uint8)
    found = cv2.morphologyEx(found, cv2.MORPH_OPEN, np.ones((3, 3), np.uint8))  # a few texels are noise
    reach = 2 * round(2 * WINDOW_SIGMA) + 1
    return cv2.dilate(found, np.ones((reach, reach), np.uint8)) > 0


def _disagreement(colour: np.ndarray, known: np.ndarray, variance: np.ndarray) -> np.ndarray:
    """Return (h, w): standard deviation between views over that between the known texels (h, w) bool around each texel."""
    mean, square, between = (_windowed(values, known) for values in (colour, colour * colour, variance))
    return np.sqrt(between / np.maximum((square - mean * mean).mean(-1), 1e-8))


def _contrast(colour: np.ndarray, known: np.ndarray) -> np.ndarray:
    """Return (h, w): standard deviation over mean of the brightness of known texels (h, w) bool around each texel; colour: (h, w, 3)."""
    grey = cv2.cvtColor(colour, cv2.COLOR_RGB2GRAY)
    mean, square = _windowed(grey, known), _windowed(grey * grey, known)
    return np.sqrt(np.maximum(square - mean * mean, 0)) / np.maximum(mean, 1e-3)


def _windowed(values: np.ndarray, known: np.ndarray) -> np.ndarray:
    """Return the mean of values (h, w) or (h, w, C) over the known texels (h, w) bool in the window around each texel."""
    weight = known.astype(np.float32)
    total = np.maximum(cv2.GaussianBlur(weight, (0, 0), WINDOW_SIGMA), 1e-3)
    if values.ndim == 3:
        weight, total = weight[..., None], total[..., None]
    return cv2.GaussianBlur(values * weight, (0, 0), WINDOW_SIGMA) / total


def _robust_mean(jobs: Sequence[_Job], side: int, rounds: int, reference: tuple[np.ndarray, np.ndarray] | None = None) -> _RobustMean:
    """Average photographs on the plane, with less weight where they differ from the mean of the round before.

    Args:
        jobs: arguments of `_on_plane`.
        side: texels along a side.
        rounds: number of rounds of averaging.
        reference: colours (side, side, 3), and (side, side) True where they tell exposures; None: the mean of the round before does.

    Returns:
        The mean (side, side, 3), and the sum of weights, the number of views, and the variance between views of each texel (side, side).
    """
    mean, weight, count, variance = np.zeros((side, side, 3), np.float32), *np.zeros((3, side, side), np.float32)
    for turn in range(rounds):
        exposure = reference if reference is not None else (mean, weight > MIN_WEIGHT)
        total, sum_of_weights, count, squares = np.zeros_like(mean), np.full_like(weight, 1e-6), *np.zeros((2, side, side), np.float32)
        for colour, seen in chain.from_iterable(
            run_jobs(_on_plane, jobs[k : k + PHOTOGRAPHS_AT_ONCE]) for k in range(0, len(jobs), PHOTOGRAPHS_AT_ONCE)
        ):
            count += seen
            colour = colour * _gain(exposure[0], colour, seen * exposure[1])
            difference = np.square(colour - mean).mean(-1)
            if turn > 0:
                seen = seen / (1 + difference / NOISE_DIFFERENCE**2) ** 2
            total += seen[..., None] * colour
            sum_of_weights += seen
            squares += seen * difference
        mean, weight, variance = total / sum_of_weights[..., None], sum_of_weights, squares / sum_of_weights
    return mean, weight, count, variance


def _frame(cameras: Sequence[Camera], plane: SupportPlane, bound: Bound) -> tuple[np.ndarray, int]:
    """Return the texels' frame (4, 3) and their number along a side: about as large as pixels at the object."""
    centre, focal = np.asarray(bound.centre), np.median([camera.fx for camera in cameras])
    pixel = np.median([np.linalg.norm(camera.centre - centre) for camera in cameras]) / focal
    side = int(np.clip(2 * TEXTURE_REACH * bound.radius / pixel, 64, MAX_TEXTURE))
    across, along = plane.axes() * (2 * TEXTURE_REACH * bound.radius / side)
    foot = centre - plane.height(centre) * plane.normal
    corner = foot - (across + along) * (side - 1) / 2
    return np.stack([np.append(across, 0), np.append(along, 0), np.append(corner, 1)], 1), side


def _projection(camera: Camera) -> np.ndarray:
    """Return the (3, 4) matrix from homogeneous world points to (column, row, 1) times depth, with whole numbers at pixel centres."""
    return replace(camera, cx=camera.cx - 0.5, cy=camera.cy - 0.5).projection


def _in_front(to_texel: np.ndarray, height: int, width: int) -> np.ndarray:
    """Return (H, W) True for the pixels whose rays meet the plane in front of the camera."""
    # A homography's third row has the sign of the depth, which is positive at texels in front of the camera.
    column, row = np.meshgrid(np.arange(width), np.arange(height))
    return to_texel[2, 0] * column + to_texel[2, 1] * row + to_texel[2, 2] > 0


def _free(mask: np.ndarray, clear: float) -> np.ndarray:
    """Return (H, W) uint8, 255 away from the object's mask, else 0; `clear` is the distance kept, in the image's longest sides."""
    reach = 2 * max(1, round(clear * max(mask.shape))) + 1
    return 255 * (cv2.dilate((mask > 0.02).astype(np.uint8), np.ones((reach, reach), np.uint8)) == 0).astype(np.uint8)


def _on_plane(colour: np.ndarray, free: np.ndarray, camera: Camera, frame: np.ndarray, side: int) -> tuple[np.ndarray, np.ndarray]:
    """Return a photograph's colours (side, side, 3) float32 at the texels, and (side, side) float32, 1 where it shows them."""
    matrix = _projection(camera) @ frame
    flags = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
    warped = cv2.warpPerspective(colour, matrix, (side, side), flags=flags).astype(np.float32) / 255
    seen = cv2.warpPerspective(free, matrix, (side, side), flags=flags)
    return warped, ((seen > 252) & _in_front(matrix, side, side)).astype(np.float32)


def _gain(mean: np.ndarray, colour: np.ndarray, seen: np.ndarray) -> np.ndarray:
    """Return the factors (3,) that bring a photograph's colours (h, w, 3) to the mean's where it is seen; 1 where nothing is."""
    shown = seen > 0
    if not shown.any():
        return np.ones(3, np.float32)
    return np.median(mean[shown][::16], 0) / np.maximum(np.median(colour[shown][::16], 0), 1e-3)
