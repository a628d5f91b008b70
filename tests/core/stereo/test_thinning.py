# SPDX-License-Identifier: GPL-3.0-or-later
"""Thinned points."""

import numpy as np
from irgspp.core.stereo.fusion import OrientedPoints
from irgspp.core.stereo.thinning import thinned


def test_thinned_points_are_averages_in_order_of_support():
    rng = np.random.default_rng(0)
    position = rng.random((5000, 3)).astype(np.float32)
    normal = np.tile(np.array([[0, 0, 1]], np.float32), (5000, 1))
    few = thinned(OrientedPoints(position, normal, position, np.ones(5000, np.int32)), 400)
    assert 250 < len(few.position) <= 400
    assert few.support.sum() == 5000
    assert np.allclose(few.normal, [0, 0, 1], atol=1e-6)
    assert np.allclose(few.position, few.colour, atol=1e-6)
    assert thinned(few, 400) is few
