# SPDX-License-Identifier: GPL-3.0-or-later
"""Means over the points of each voxel."""

import numpy as np
import pytest
from irgspp.core.scene.voxel_means import voxel_means

CELLS = np.array([[2, 0, 0], [0, 1, 5], [2, 0, 0], [-1, 7, 0]])
VALUES = np.array([[1, 10], [2, 20], [3, 60], [4, 40]], np.float32)


def test_points_of_a_voxel_are_averaged():
    (mean, same), count = voxel_means(CELLS, (VALUES, VALUES[:, :1]))
    assert mean.tolist() == [[4, 40], [2, 20], [2, 35]] and count.tolist() == [1, 1, 2]
    np.testing.assert_array_equal(same, mean[:, :1])


def test_weights_count():
    weight = np.array([3, 5, 1, 2], np.int32)
    (mean,), total = voxel_means(CELLS, (VALUES,), weight)
    assert mean[2].tolist() == pytest.approx([1.5, 22.5]) and total.tolist() == [2, 5, 4]
