# SPDX-License-Identifier: GPL-3.0-or-later
"""Log-likelihood ratios of background to object, learned from histograms of differences in the pixels that are sure."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.ndimage import gaussian_filter1d

BINS = 32  # of the histograms of differences
SHARED_WEIGHT = 0.5  # weight of the histograms of all views against those of the view itself
MIN_PIXELS = 200  # pixels of each kind without which there is no evidence, and from which a view's own histogram counts
PROBABILITY_FLOOR = 3e-3  # probability of a bin that nothing fell into


def log_likelihood_ratios(
    differences: Sequence[np.ndarray], background: Sequence[np.ndarray], inside: Sequence[np.ndarray], widest: float
) -> list[np.ndarray]:
    """Return the log-likelihood ratio (H, W) float32, in nats, of background to object in each view.

    Two smoothed histograms, one of the background's differences and one of the object's, are counted in the pixels that are sure; each
    view's own are mixed with those of all views.

    Args:
        differences: (H, W) float32 >= 0 of each view, between the photograph and an expected colour; NaN where it is not known.
        background: (H, W) bool of each view, pixels that are surely the background.
        inside: (H, W) bool of each view, pixels that are surely the object.
        widest: the difference from which on all fall into the last bin.

    Returns:
        The ratios, > 0 where the background is likelier; 0 where a difference is not known, and everywhere if too few pixels are sure.
    """
    counts = [[_histogram(one[kind], widest) for kind in kinds] for one, *kinds in zip(differences, background, inside, strict=True)]
    shared = np.sum(counts, 0, np.float64) if counts else np.zeros((2, BINS))
    if shared.sum(1).min() < MIN_PIXELS:
        return [np.zeros(one.shape, np.float32) for one in differences]
    result = []
    for one, own in zip(differences, counts, strict=True):
        outer, inner = (_probability(own[k], shared[k]) for k in (0, 1))
        ratio = np.log(outer / inner).astype(np.float32)
        result.append(np.where(np.isnan(one), np.float32(0), ratio[_bins(np.nan_to_num(one), widest)]))
    return result


def _bins(difference: np.ndarray, widest: float) -> np.ndarray:
    return np.minimum(difference * (BINS / widest), BINS - 1).astype(np.int64)


def _histogram(difference: np.ndarray, widest: float) -> np.ndarray:
    """Return the counts (BINS,) of differences (N,) that are known."""
    return np.bincount(_bins(difference[~np.isnan(difference)], widest), minlength=BINS).astype(np.float64)


def _probability(own: np.ndarray, shared: np.ndarray) -> np.ndarray:
    """Return the probability (BINS,) of each bin from a view's own counts and those of all views."""
    mixed = shared / shared.sum()
    if own.sum() >= MIN_PIXELS:
        mixed = SHARED_WEIGHT * mixed + (1 - SHARED_WEIGHT) * own / own.sum()
    return gaussian_filter1d(mixed, 1.0, mode="nearest") + PROBABILITY_FLOOR
