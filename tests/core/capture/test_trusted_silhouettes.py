# SPDX-License-Identifier: GPL-3.0-or-later
"""Silhouettes beside the object's points of stereo."""

import numpy as np
from irgspp.core.capture.trusted_silhouettes import trusted_silhouettes


def test_a_silhouette_is_less_sure_away_from_points_but_not_where_they_enclose_it():
    """The points are two wheels, a body over them, and a hole in it; the silhouette fills the space between the wheels."""
    silhouette, near = np.zeros((40, 60), np.float32), np.zeros((40, 60), np.float32)
    silhouette[5:35, 5:55] = 1.0
    near[5:25, 5:55] = near[25:35, 5:15] = near[25:35, 45:55] = 1.0
    near[10:14, 28:32] = 0.0
    (found,) = trusted_silhouettes([silhouette], [near])
    assert np.all(found[26:35, 16:44] < 0.5)  # between the wheels
    assert np.all(found[5:25, 5:55] == 1.0)  # the body, and the hole that points enclose
    assert np.all(found[silhouette == 0] == 0)


def test_silhouettes_of_an_object_without_points_stay():
    silhouette = np.full((20, 20), 0.95, np.float32)
    few = np.zeros((20, 20), np.float32)
    few[3, 3] = 1.0
    for near in (np.full((20, 20), 0.57, np.float32), few):
        (found,) = trusted_silhouettes([silhouette], [near])
        assert np.all(found > 0.9)
