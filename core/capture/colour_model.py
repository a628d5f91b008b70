# SPDX-License-Identifier: GPL-3.0-or-later
"""Colour models of the object and of its surroundings: smoothed histograms in Lab."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from scipy.ndimage import gaussian_filter

BINS = (16, 24, 24)  # of L, a and b
LOW, HIGH = np.array([0.0, -60.0, -60.0], np.float32), np.array([100.0, 60.0, 60.0], np.float32)  # Lab values that the bins span
BLUR = 0.8  # bins, sigma of the smoothing
FLOOR = 2e-5  # probability of a bin that no colour fell into


@dataclass(frozen=True, eq=False)
class ColourModel:
    """Probabilities (B,) of the bins of colours in one view.

    Attributes:
        object: of the object.
        background: of what lies around it.
        beyond: of what lies around it where the support plane can't be, such as the room behind a table. The table's colours are no
            background there, so that parts that have them are found.
    """

    object: np.ndarray
    background: np.ndarray
    beyond: np.ndarray


def lab_bins(colour: np.ndarray) -> np.ndarray:
    """Return the flat index (H, W) int32 of the Lab bin of each colour (H, W, 3) float32 sRGB."""
    lab = cv2.cvtColor(np.clip(colour, 0, 1).astype(np.float32), cv2.COLOR_RGB2LAB)
    cell = ((lab - LOW) / (HIGH - LOW) * np.array(BINS, np.float32)).astype(np.int32)
    cell = np.clip(cell, 0, np.array(BINS) - 1)
    return (cell[..., 0] * BINS[1] + cell[..., 1]) * BINS[2] + cell[..., 2]


def count_colours(bins: np.ndarray, weight: np.ndarray) -> np.ndarray:
    """Return the histogram (B,) float64 of bins (N,) with weights (N,)."""
    return np.bincount(bins.reshape(-1), weight.reshape(-1).astype(np.float64), int(np.prod(BINS)))


def probabilities(counts: np.ndarray) -> np.ndarray:
    """Return the probability (B,) of each bin from counts (B,), smoothed; uniform where nothing was counted."""
    total = counts.sum()
    if total <= 0:
        return np.full(counts.shape, 1 / counts.size)
    smooth = gaussian_filter(counts.reshape(BINS) / total, BLUR, mode="constant").reshape(-1)
    return smooth + FLOOR
