# SPDX-License-Identifier: GPL-3.0-or-later
"""Photographs that a reconstruction is better off without: black or white, blurred, or taken twice from the same place."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from PIL import Image

from .photograph import LeftOut

BLUR_SIDE = 640  # longest side at which blur is measured, pixels: blur that vanishes there does no harm
THUMBNAIL_SIDE = 320  # longest side at which displacements are measured, pixels
DIRECTIONS = 8  # in which gradients are measured, in half a turn: motion blurs one of them
DARKEST_TONE, BRIGHTEST_TONE = 10, 250  # grey levels between which tones are usable
MIN_TONES_FRACTION = 0.02  # fraction of pixels with such tones
BLACK_LEVEL, WHITE_LEVEL = 64, 192  # grey levels below which, and above which, such a photograph is called black or white
MIN_CONTRAST = 8.0  # grey levels between the 1st and 99th percentile
BLURRED_OCTAVES = 0.65  # octaves of the energy ratio below the median: a streak of 4 pixels at BLUR_SIDE, or a Gaussian of 1 pixel
BLURRED_DEVIATIONS = 3.5  # as many standard deviations of the set below, at least
MIN_GROUP = 5  # photographs of a lens from which on they are compared among themselves
MIN_MEDIAN_ENERGY = -1.45  # median log2 energy ratio below which all photographs are blurred; sharp sets have -0.2 to -0.9
TINY_SIDE = 16  # side of the images that are compared all with all, pixels
# Normalised correlation of these above which displacements are measured; a displacement of MAX_IDENTICAL_MOVE leaves 0.99.
MIN_CORRELATION = 0.95
MAX_CORNERS, MIN_CORNERS, TRACKING_WINDOW = 300, 30, 15  # tracked corners, fewest of them, and side of their windows in pixels
MIN_TRACKED_FRACTION = 0.95  # fraction of corners that must be found again, forwards and backwards, within MAX_RETURN_ERROR pixels
MAX_RETURN_ERROR = 0.5
MAX_IDENTICAL_MOVE = 4.0  # median displacement up to which photographs are near-identical, pixels of THUMBNAIL_SIDE
STILL_PERCENTAGE = 98  # percentage of the corners that must not move beyond a homography: an object on a turntable may be small
MAX_STILL_PARALLAX = 0.6  # up to which they do not, pixels of THUMBNAIL_SIDE: the noise of tracking is half of it
MIN_SHARPER_OCTAVES = 0.15  # octaves by which the second photograph must be sharper to be kept in place of the first


@dataclass(frozen=True, eq=False)
class Appearance:
    """Measures of a photograph.

    Attributes:
        grey: (h, w) uint8 thumbnail with a longest side of THUMBNAIL_SIDE at most.
        sharpness: (DIRECTIONS,) log2 of the gradient energy in the finest octave over that in the next.
        fault: reason why it has nothing to see; else empty.
    """

    grey: np.ndarray
    sharpness: np.ndarray
    fault: str


def read_appearance(path: Path) -> Appearance:
    """Measure an upright copy; a JPEG is decoded at a fraction of its size.

    Args:
        path: JPEG or PNG of the capture's folder.
    """
    with Image.open(path) as image:
        image.draft("L", (BLUR_SIDE, BLUR_SIDE))
        deep = image.mode.startswith("I")
        grey = np.asarray(image if deep else image.convert("L"))
    return appearance((grey >> 8).astype(np.uint8) if deep else grey)


def appearance(grey: np.ndarray) -> Appearance:
    """Measure a grey image.

    Args:
        grey: (H, W) uint8.
    """
    grey = _reduced(grey, BLUR_SIDE)
    usable = np.mean((grey > DARKEST_TONE) & (grey < BRIGHTEST_TONE))
    low, high = np.percentile(grey, [1, 99])
    fault = ""
    if usable < MIN_TONES_FRACTION or high - low < MIN_CONTRAST:
        fault = (
            "black: underexposed" if high < BLACK_LEVEL else "white: overexposed" if low > WHITE_LEVEL else "uniform: nothing is visible"
        )
    return Appearance(_reduced(grey, THUMBNAIL_SIDE), _sharpness(grey), fault)


def unusable(names: list[str], lenses: list[str], seen: list[Appearance]) -> tuple[list[LeftOut], list[str]]:
    """Select photographs to leave out.

    Args:
        names: names of the photographs, in the order of capture.
        lenses: key of each photograph's lens; sharpness is compared among photographs of one lens.
        seen: their measures.

    Returns:
        Photographs to leave out, in order, and warnings for the user. At least half of those that show anything are kept.
    """
    faults = {i: a.fault for i, a in enumerate(seen) if a.fault}
    rest = [i for i in range(len(names)) if i not in faults]
    warnings: list[str] = []
    blurred = {rest[i]: b for i, b in _blurred([seen[i] for i in rest], [lenses[i] for i in rest]).items()}
    if len(blurred) > len(rest) / 2:
        blurred = {}
    if rest and np.median([seen[i].sharpness.mean() for i in rest]) < MIN_MEDIAN_ENERGY:
        warnings.append("the photographs are blurred or out of focus as a whole: fine detail will be missing")
    faults |= {i: f"blurred: {2**octaves:.1f} times less fine detail than the others" for i, octaves in blurred.items()}
    sharp = [i for i in rest if i not in faults]
    twins = _twins(sharp, seen)
    spare = len(sharp) - (len(rest) + 1) // 2
    if len(twins) > spare:
        warnings.append(f"{len(twins)} of {len(rest)} photographs were taken twice from the same place: walk around the object")
    for i, kept in list(twins.items())[: max(spare, 0)]:
        faults[i] = f"near-identical to {names[kept]}: taken from the same place"
    return [LeftOut(names[i], faults[i]) for i in sorted(faults)], warnings


def _reduced(grey: np.ndarray, longest: int) -> np.ndarray:
    scale = longest / max(grey.shape)
    if scale >= 1:
        return grey
    size = max(round(grey.shape[1] * scale), 1), max(round(grey.shape[0] * scale), 1)
    return cv2.resize(grey, size, interpolation=cv2.INTER_AREA)


def _sharpness(grey: np.ndarray) -> np.ndarray:
    """Return log2 of the ratio of gradient energy in two octaves for each direction."""
    fine = grey.astype(np.float32)
    energies = [_directional_energy(fine), _directional_energy(cv2.pyrDown(fine))]
    return np.log2((energies[0] + 1e-3) / (energies[1] + 1e-3))


def _directional_energy(grey: np.ndarray) -> np.ndarray:
    """Return the mean squared derivative (DIRECTIONS,) in each direction, from the structure tensor."""
    x, y = (cv2.Sobel(grey, cv2.CV_32F, *d, ksize=3) / 8 for d in ((1, 0), (0, 1)))
    xx, xy, yy = np.mean(x * x), np.mean(x * y), np.mean(y * y)
    angle = np.arange(DIRECTIONS) * np.pi / DIRECTIONS
    return np.cos(angle) ** 2 * xx + 2 * np.sin(angle) * np.cos(angle) * xy + np.sin(angle) ** 2 * yy


def _blurred(seen: list[Appearance], lenses: list[str]) -> dict[int, float]:
    """Return the photographs whose worst direction is far below the median, with the distance in octaves."""
    if not seen:
        return {}
    counts, found = Counter(lenses), {}
    every = np.stack([a.sharpness for a in seen])
    for i, lens in enumerate(lenses):
        own = every if counts[lens] < MIN_GROUP else every[[other == lens for other in lenses]]
        below = np.median(own, 0) - own
        spread = 1.4826 * np.median(np.abs(below.max(1) - np.median(below.max(1))))
        worst = float((np.median(own, 0) - every[i]).max())
        if worst > max(BLURRED_OCTAVES, BLURRED_DEVIATIONS * spread):
            found[i] = worst
    return found


def _twins(chosen: list[int], seen: list[Appearance]) -> dict[int, int]:
    """Return for each near-identical photograph the one that is kept in its place."""
    replaced: dict[int, int] = {}
    for first, second in _similar_pairs(chosen, seen):
        if first in replaced or second in replaced or not same_place(seen[first].grey, seen[second].grey):
            continue
        better = seen[second].sharpness.mean() > seen[first].sharpness.mean() + MIN_SHARPER_OCTAVES
        replaced[first if better else second] = second if better else first
    return replaced


def _similar_pairs(chosen: list[int], seen: list[Appearance]) -> list[tuple[int, int]]:
    """Return pairs of photographs of equal size whose tiny images correlate."""
    if len(chosen) < 2:
        return []
    tiny = np.stack([cv2.resize(seen[i].grey, (TINY_SIDE, TINY_SIDE), interpolation=cv2.INTER_AREA).ravel() for i in chosen]).astype(
        np.float32
    )
    tiny -= tiny.mean(1, keepdims=True)
    tiny /= np.maximum(np.linalg.norm(tiny, axis=1, keepdims=True), 1e-6)
    pairs = np.argwhere(np.triu(tiny @ tiny.T, 1) > MIN_CORRELATION)
    return [(chosen[i], chosen[j]) for i, j in pairs if seen[chosen[i]].grey.shape == seen[chosen[j]].grey.shape]


def same_place(first: np.ndarray, second: np.ndarray) -> bool:
    """Check whether two thumbnails were taken from the same place: a small displacement, and no parallax beyond a homography.

    Args:
        first: (h, w) uint8.
        second: (h, w) uint8.
    """
    first, second = cv2.equalizeHist(first), cv2.equalizeHist(second)  # exposures may differ
    corners = cv2.goodFeaturesToTrack(first, MAX_CORNERS, 0.01, 5)
    if corners is None or len(corners) < MIN_CORNERS:
        return False
    size = (TRACKING_WINDOW, TRACKING_WINDOW)
    there, found, _ = cv2.calcOpticalFlowPyrLK(first, second, corners, None, winSize=size)  # pyright: ignore[reportCallIssue, reportArgumentType]
    back, again, _ = cv2.calcOpticalFlowPyrLK(second, first, there, None, winSize=size)  # pyright: ignore[reportCallIssue, reportArgumentType]
    kept = (found[:, 0] > 0) & (again[:, 0] > 0) & (np.linalg.norm((corners - back)[:, 0], axis=1) < MAX_RETURN_ERROR)
    if kept.mean() < MIN_TRACKED_FRACTION or kept.sum() < MIN_CORNERS:
        return False
    start, end = corners[kept, 0], there[kept, 0]
    if np.median(np.linalg.norm(end - start, axis=1)) > MAX_IDENTICAL_MOVE:
        return False
    plane, _ = cv2.findHomography(start, end, cv2.RANSAC, 1.0)
    if plane is None:
        return False
    left = np.linalg.norm(cv2.perspectiveTransform(start[:, None], plane)[:, 0] - end, axis=1)
    return bool(np.percentile(left, STILL_PERCENTAGE) < MAX_STILL_PARALLAX)
