# SPDX-License-Identifier: GPL-3.0-or-later
"""Colours at the edge of a ball on a patterned table, in photographs whose pixels mix both."""

import cv2
import numpy as np
import pytest
from irgspp.core.capture.edge_colours import edge_colours
from irgspp.core.capture.plane_texture import plane_texture
from patterned_table import BOUND, PLANE, cameras, on_table, pattern, photographs

ERROR = 2.0  # of the masks, pixels
SIGMA = 0.8  # of the lens' blur, pixels


def colours_of(ball):
    """Edge colours of the first photograph, and the true coverage of its pixels by a ball of one colour."""
    cams, (sharp, masks) = cameras(), photographs(cameras(), ball)
    photos = [cv2.GaussianBlur(photo, (0, 0), SIGMA) for photo in sharp]
    texture = plane_texture(photos, cams, masks, PLANE, BOUND)
    fitted = np.broadcast_to(np.float32(ball), photos[0].shape), masks[0]
    return edge_colours(texture, photos[0], cams[0], masks[0], fitted, ERROR), cv2.GaussianBlur(masks[0], (0, 0), SIGMA)


def test_coverage_of_mixed_pixels():
    """Neither nearer to the object nor to the background: what counts is how much of a pixel the object covers."""
    found, true = colours_of((0.1, 0.9, 0.9))
    mixed = (true > 0.1) & (true < 0.9) & (found.reliability > 0.8)
    assert mixed.sum() > 60
    error = (found.coverage - true)[mixed]
    assert abs(error.mean()) < 0.03 and np.abs(error).mean() < 0.06


def test_coverage_is_not_reliable_where_colours_are_alike():
    found, true = colours_of((0.5, 0.45, 0.3))  # the table's mean
    unlike = np.abs(pattern(*on_table(cameras()[0])) - (0.5, 0.45, 0.3)).max(-1)
    mixed = (true > 0.1) & (true < 0.9)
    assert found.reliability[mixed & (unlike < 0.05)].max() < 0.4 < found.reliability[mixed & (unlike > 0.25)].min()
    assert found.coverage.min() >= 0 and found.coverage.max() <= 1


@pytest.mark.parametrize("ball", [(0.1, 0.9, 0.9), (0.5, 0.45, 0.3)])
def test_sure_pixels_are_apart(ball):
    found, true = colours_of(ball)
    assert true[found.inside].min() > 0.99 and true[found.outside].max() < 0.01
