# SPDX-License-Identifier: GPL-3.0-or-later
"""Smoothness and size of light maps."""

import math

import pytest
import torch
from irgspp.core.stages.common.light_map import LIGHT_SLOPE, light_variation, resized_light


def test_variation_wraps_around_the_seam():
    light = torch.zeros(4, 8, 3)
    light[:, 0] = 1e-3
    assert light_variation(light) == pytest.approx(1e-6 * 2 / 8, rel=1e-4)  # up and down again, once across the seam
    assert light_variation(torch.ones(4, 8, 3)) == 0


def test_an_edge_counts_less_than_its_square():
    edge = LIGHT_SLOPE * math.pi / 4  # between texels of a map of four rows
    light = torch.zeros(4, 8, 3)
    light[:, :4] = 10 * edge
    assert light_variation(light) == pytest.approx(edge**2 * math.log(101) * 2 / 8, rel=1e-5)


def test_a_map_grows_and_never_shrinks():
    assert resized_light(torch.ones(8, 16, 3), 32).shape == (32, 64, 3)
    assert resized_light(torch.ones(8, 16, 3), 4).shape == (8, 16, 3)
