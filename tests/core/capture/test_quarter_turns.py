# SPDX-License-Identifier: GPL-3.0-or-later
"""Quarter turns: pixels go where numpy's rotation puts them, and a turned lens with its turned camera projects to the turned pixels."""

import cv2
import numpy as np
import pytest
from irgspp.core.capture.quarter_turns import camera_turn, turn_lens, turn_pixels
from irgspp.core.datasets.parsed_dataset import Lens

LENS = Lens("OPENCV", 64, 48, 60.0, 57.0, 30.0, 25.0, (-0.1, 0.03, 0.004, -0.007, 0.0))


def project(lens, points):
    matrix = np.array([[lens.fx, 0, lens.cx], [0, lens.fy, lens.cy], [0, 0, 1]])
    return cv2.projectPoints(points, np.zeros(3), np.zeros(3), matrix, np.array(lens.distortion))[0].reshape(-1, 2)


@pytest.mark.parametrize("turns", range(5))
def test_pixels_turn_as_the_image(turns):
    image = np.arange(48 * 64).reshape(48, 64)
    places = np.array([[3.5, 7.5], [60.5, 0.5], [0.5, 47.5]])
    turned = turn_pixels(places, 64, 48, turns)
    column, row = turned.astype(int).T
    assert (np.rot90(image, turns)[row, column] == image[places[:, 1].astype(int), places[:, 0].astype(int)]).all()


@pytest.mark.parametrize("turns", range(4))
def test_lens_and_camera_turn_together(turns):
    points = np.random.default_rng(0).normal(size=(20, 3)) * 0.3 + (0, 0, 2)
    lens = turn_lens(LENS, turns)
    assert lens.size == ((48, 64) if turns % 2 else (64, 48))
    expected = turn_pixels(project(LENS, points), 64, 48, turns)
    np.testing.assert_allclose(project(lens, points @ camera_turn(turns).T), expected, atol=1e-9)
