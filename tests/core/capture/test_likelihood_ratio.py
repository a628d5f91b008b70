# SPDX-License-Identifier: GPL-3.0-or-later
"""Log-likelihood ratios of background to object from histograms of differences."""

import numpy as np
import pytest
from irgspp.core.capture.likelihood_ratio import BINS, MIN_PIXELS, PROBABILITY_FLOOR, log_likelihood_ratios


def one_view(count: int, background: float, inside: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return differences (2, count) with a row of the background and a row of the object, and where either is sure."""
    difference = np.stack([np.full(count, background, np.float32), np.full(count, inside, np.float32)])
    rows = np.arange(2)[:, None].repeat(count, 1)
    return difference, rows == 0, rows == 1


def test_what_differs_little_is_the_background_where_the_background_does():
    difference, background, inside = one_view(MIN_PIXELS, 0.05, 0.6)
    (ratio,) = log_likelihood_ratios([difference], [background], [inside], 0.8)
    assert ratio.dtype == np.float32 and ratio.shape == difference.shape
    assert (ratio[0] > 4).all() and (ratio[1] < -4).all()
    peak = 0.39894  # of a Gaussian of one bin: all pixels of a kind fell into a single one
    assert ratio[0, 0] == pytest.approx(np.log((peak + PROBABILITY_FLOOR) / PROBABILITY_FLOOR), abs=1e-3)


def test_unknown_differences_and_too_few_sure_pixels_are_no_evidence():
    difference, background, inside = one_view(MIN_PIXELS, 0.05, 0.6)
    difference[:, -1] = np.nan
    (few,) = log_likelihood_ratios([difference], [background], [inside], 0.8)
    assert not few.any()
    two = log_likelihood_ratios([difference] * 2, [background] * 2, [inside] * 2, 0.8)
    assert all((one[:, -1] == 0).all() and (one[:, :-1] != 0).all() for one in two)
    assert log_likelihood_ratios([], [], [], 0.8) == []


def test_views_with_too_few_pixels_of_their_own_take_those_of_all_views():
    known, empty = one_view(MIN_PIXELS, 0.05, 0.6), one_view(10, 0.05, 0.6)
    nothing = np.zeros_like(empty[1])
    first, second = log_likelihood_ratios([known[0], empty[0]], [known[1], nothing], [known[2], nothing], 0.8)
    np.testing.assert_array_equal(second, first[:, :10])


def test_larger_differences_than_the_widest_fall_into_the_last_bin():
    difference, background, inside = one_view(MIN_PIXELS, 0.0, 0.8 * (BINS - 0.5) / BINS)
    beyond = difference.copy()
    beyond[1] *= 10
    (ratio,), (far,) = (log_likelihood_ratios([one], [background], [inside], 0.8) for one in (difference, beyond))
    np.testing.assert_array_equal(ratio, far)
