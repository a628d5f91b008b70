# SPDX-License-Identifier: GPL-3.0-or-later
"""Colours continued from known pixels."""

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
