# SPDX-License-Identifier: GPL-3.0-or-later
"""Alignment of small patches with an image to a fraction of a pixel (Lucas and Kanade 1981)."""

from __future__ import annotations

from dataclasses import dataclass
from math import floor

import numpy as np

from ..kernels.cpu.jit import kernel

STEPS = 15  # most steps for a patch
LONGEST_STEP = 1.0  # pixels
SETTLED = 0.01  # pixels; a patch that ends with a longer step has not found its place
MIN_GAIN = 1e-3  # least correlation that scales a step: without any, a step has no direction
FLAT = 1e-6  # contrast of a patch that shows nothing, in units of the image


@dataclass(frozen=True, eq=False)
class Alignment:
    """Places of N patches in an image.

    Attributes:
        shift: (N, 2) pixels from where each patch was expected, as (x, y).
        correlation: (N,) normalised cross-correlation with the image there, -1..1.
        deviation: (N,) standard deviation of the shift by what is left of the difference, pixels.
        settled: (N,) bool, the last step was short.
    """

    shift: np.ndarray
    correlation: np.ndarray
    deviation: np.ndarray
    settled: np.ndarray


def align_patches(image: np.ndarray, places: np.ndarray, patches: np.ndarray) -> Alignment:
    """Shift patches until they fit an image, whatever the brightness and contrast of the image are there.

    Args:
        image: (H, W) float32.
        places: (N, M, 2) where the M samples of each patch are expected in the image, as (x, y), with pixel centres at .5.
        patches: (N, M) values of the samples.
    """
    found = np.zeros((len(places), 5))
    align(image, np.ascontiguousarray(places, np.float64), np.ascontiguousarray(patches, np.float64), found)
    return Alignment(found[:, :2], found[:, 2], found[:, 3], found[:, 4] < SETTLED)


def sampled(image: np.ndarray, places: np.ndarray) -> np.ndarray:
    """Return the bicubic values (N, M) float64 of an image (H, W) at places (N, M, 2), with pixel centres at .5."""
    values = np.zeros(places.shape[:-1])
    sample_all(image, np.ascontiguousarray(places, np.float64), values)
    return values


@kernel
def cubic_weights(t):
    """Return the four weights of Catmull and Rom's spline at t = 0..1 between the middle two, and their derivatives."""
    weights = 0.5 * (-t + 2 * t**2 - t**3), 1 - 2.5 * t**2 + 1.5 * t**3, 0.5 * (t + 4 * t**2 - 3 * t**3), 0.5 * (t**3 - t**2)
    slopes = 0.5 * (-1 + 4 * t - 3 * t**2), -5 * t + 4.5 * t**2, 0.5 * (1 + 8 * t - 9 * t**2), 0.5 * (3 * t**2 - 2 * t)
    return weights, slopes


@kernel
def sample(image, x, y):
    """Return the bicubic value of an image (H, W) at a place, and its derivatives along x and y; the border is repeated."""
    height, width = image.shape
    x, y = min(max(x - 0.5, 0.0), width - 1.0), min(max(y - 0.5, 0.0), height - 1.0)
    column, row = floor(x), floor(y)
    across, slope_x = cubic_weights(x - column)
    down, slope_y = cubic_weights(y - row)
    value = along_x = along_y = 0.0
    for i in range(4):
        own = min(max(row + i - 1, 0), height - 1)
        line = slope = 0.0
        for j in range(4):
            pixel = image[own, min(max(column + j - 1, 0), width - 1)]
            line += across[j] * pixel
            slope += slope_x[j] * pixel
        value += down[i] * line
        along_x += down[i] * slope
        along_y += slope_y[i] * line
    return value, along_x, along_y


@kernel
def sample_all(image, places, values):
    """Write the bicubic values (N, M) of an image at places (N, M, 2)."""
    for n in range(places.shape[0]):
        for m in range(places.shape[1]):
            values[n, m] = sample(image, places[n, m, 0], places[n, m, 1])[0]


@kernel
def align(image, places, patches, found):
    """Write shift x, y, correlation, deviation and length of the last step of each patch into `found` (N, 5).

    The shift, with a contrast and a brightness of the image, makes the squared difference from the patch least, which is where their
    correlation is greatest. Steps are Gauss and Newton's. Reference: `core.kernels.reference.patch_alignment`.
    """
    count = patches.shape[1]
    seen = np.empty((3, count))  # value, derivatives along x and y
    for n in range(patches.shape[0]):
        patch, shift, length = patches[n] - patches[n].mean(), found[n, :2], np.inf
        known = np.sqrt(np.mean(patch**2)) + FLAT
        for _ in range(STEPS):
            for m in range(count):
                seen[0, m], seen[1, m], seen[2, m] = sample(image, places[n, m, 0] + shift[0], places[n, m, 1] + shift[1])
            for part in range(3):
                seen[part] -= seen[part].mean()
            contrast = np.sqrt(np.mean(seen[0] ** 2)) + FLAT
            correlation = np.mean(seen[0] * patch) / (contrast * known)
            gain = max(correlation, MIN_GAIN) * known / contrast
            xx, yy, xy = np.sum(seen[1] ** 2) + FLAT**2, np.sum(seen[2] ** 2) + FLAT**2, np.sum(seen[1] * seen[2])
            left = patch / gain - seen[0]
            right_x, right_y, area = np.sum(seen[1] * left), np.sum(seen[2] * left), xx * yy - xy * xy
            found[n, 2] = correlation
            found[n, 3] = np.sqrt(np.sum(left**2) / (count - 4) * (xx + yy) / area)
            if length < SETTLED:
                break
            step_x, step_y = (yy * right_x - xy * right_y) / area, (xx * right_y - xy * right_x) / area
            length = np.sqrt(step_x**2 + step_y**2)
            shorter = min(1.0, LONGEST_STEP / max(length, 1e-12))
            shift[0] += shorter * step_x
            shift[1] += shorter * step_y
        found[n, 4] = length
