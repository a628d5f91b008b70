# SPDX-License-Identifier: GPL-3.0-or-later
"""Evidence for one of two surfaces: a textured wall, at its own depth and at wrong ones."""

import numpy as np
import pytest
from irgspp.core.stages.first.depth_evidence import DepthEvidence
from textured_wall import BOUND, SOURCES, bent, textured_wall

RIGHT, LEFT, NOWHERE = np.array([[0.3, 0, 0]]), np.array([[-0.3, 0, 0]]), np.array([[0, 0, 0.8]])


@pytest.fixture(scope="module")
def wall():
    """The dataset, its depths, and the evidence of these against depths that are 6 % wrong in the right half."""
    dataset, depths = textured_wall()
    return dataset, depths, DepthEvidence.collect(dataset.train, BOUND, (bent(dataset, depths, 1.06), depths), SOURCES, 0.01)


def test_the_right_depth_wins_in_its_region_only(wall):
    evidence = wall[2]
    assert evidence.ratio(RIGHT)[0] < 0.5
    assert evidence.ratio(LEFT)[0] == pytest.approx(1, abs=0.02)
    assert evidence.ratio(NOWHERE)[0] == 1


def test_distance_of_the_surfaces_is_their_parallax(wall):
    evidence = wall[2]
    assert evidence.distance(RIGHT)[0] == pytest.approx(90 * (1 - 1 / 1.06), rel=0.02)  # focal length times relative difference
    assert evidence.distance(LEFT)[0] == pytest.approx(0, abs=0.01)


def test_errors_at_the_right_depth_are_those_of_interpolation(wall):
    evidence = wall[2]
    assert 0 < evidence.error(LEFT)[0] < 0.02
    assert evidence.error(NOWHERE)[0] == 0
    assert evidence.typical_error() == pytest.approx(evidence.error(LEFT)[0], rel=0.5)


def test_equal_depths_are_equally_good(wall):
    dataset, depths, _ = wall
    evidence = DepthEvidence.collect(dataset.train, BOUND, (depths, depths), SOURCES, 0.01)
    points = np.random.default_rng(0).uniform(-0.5, 0.5, (50, 3)) * [1, 1, 0]
    assert np.allclose(evidence.ratio(points), 1)
    assert np.all(evidence.distance(points) == 0)
