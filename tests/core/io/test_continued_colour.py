# SPDX-License-Identifier: GPL-3.0-or-later
"""Colours continued from known pixels."""

import cv2
import numpy as np
from irgspp.core.io.continued_colour import continued_colour


def test_known_pixels_stay_and_others_take_their_neighbours():
    colour = np.zeros((20, 40, 3), np.float32)
    colour[:, :12], colour[:, 28:] = (0.8, 0.4, 0.2), (0.1, 0.2, 0.9)
    known = np.ones((20, 40), bool)
    known[:, 12:28] = False
    found = continued_colour(np.where(known[..., None], colour, 7), known, 1.0, 6)
    assert np.array_equal(found[known], colour[known])
    assert np.allclose(found[:, 14], (0.8, 0.4, 0.2), atol=1e-3) and np.allclose(found[:, 25], (0.1, 0.2, 0.9), atol=1e-3)


def test_pixels_out_of_reach_are_black():
    known = np.zeros((30, 200), bool)
    known[:, :5] = True
    found = continued_colour(np.ones((30, 200, 3), np.float32), known, 1.0, 2)
    assert found[:, 8].min() > 0.99 and not found[:, 100:].any()
    assert not continued_colour(np.ones((4, 4, 3), np.float32), np.zeros((4, 4), bool), 1.0, 3).any()


def test_wide_windows_are_averaged_on_a_reduced_image():
    """Against blurs of the whole image; the reduction is seen as a shift of less than a tenth of the window."""
    random = np.random.default_rng(0)
    colour = cv2.GaussianBlur(random.random((150, 190, 3), np.float32), (0, 0), 12.0)
    known = np.zeros((150, 190), bool)
    known[:, :40] = True
    sigma, weight = 24.0, known.astype(np.float32)
    blurred, near = (cv2.GaussianBlur(a, (0, 0), sigma) for a in (colour * weight[..., None], weight))
    found = continued_colour(colour, known, sigma, 1)
    reached = ~known & (near > 0.05)
    np.testing.assert_allclose(found[reached], blurred[reached] / near[reached][:, None], atol=0.01)


def test_windows_stop_where_all_wanted_pixels_are_reached():
    known, wanted = np.zeros((20, 100), bool), np.zeros((20, 100), bool)
    known[:, :5], wanted[:, 5:8] = True, True
    colour = np.ones((20, 100, 3), np.float32)
    near, whole = continued_colour(colour, known, 2.0, 8, wanted), continued_colour(colour, known, 2.0, 8)
    assert np.array_equal(near[wanted], whole[wanted]) and near[wanted].min() > 0.99
    assert not near[:, 60:].any() and whole[:, 60:].all()
