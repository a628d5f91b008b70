# SPDX-License-Identifier: GPL-3.0-or-later
"""Confidence of the recovered light: low at edges and where nothing is known, and the same everywhere on the sphere."""

import numpy as np
import pytest
from irgspp.core.evaluation.light_confidence import HALF_CONTRAST, MAX_UNCONSTRAINED, light_confidence
from irgspp.core.shading.environment_lookup import texel_directions

EVERYWHERE = np.ones((64, 128), bool)


def lamp(direction):
    """A light (64, 128, 3) that is bright within 20 degrees of a direction."""
    cosine = texel_directions(64, 128).numpy() @ np.asarray(direction, np.float32)
    return np.where(cosine > np.cos(np.radians(20)), 0.8, 0.2)[..., None].repeat(3, -1), np.degrees(np.arccos(cosine.clip(-1, 1)))


def test_an_even_light_is_sure_where_the_photographs_constrain_it():
    part = EVERYWHERE.copy()
    part[40:] = False
    confidence = light_confidence(np.full((64, 128, 3), 0.4), part)
    assert np.allclose(confidence[:40], 1) and np.allclose(confidence[40:], MAX_UNCONSTRAINED)


@pytest.mark.parametrize("direction", [(1, 0, 0), (-1, 0, 0), (0, 0.6, 0.8), (0, 0.1, 0.995)])
def test_edges_are_unsure_wherever_they_lie(direction):
    light, angle = lamp(direction)
    confidence = light_confidence(light, EVERYWHERE)
    assert confidence[abs(angle - 20) < 1.5].max() < 0.5 and confidence[abs(angle - 20) > 15].min() > 0.95


def test_values_above_white_are_alike():
    light = np.full((64, 128, 3), 2.0)
    light[:, 64:] = 9.0
    assert np.allclose(light_confidence(light, EVERYWHERE), 1)


def test_half_contrast_halves_the_confidence():
    fine = np.indices((64, 128)).sum(0) % 2  # a pattern much finer than the window: its standard deviation is that of the whole
    encoded = 0.5 + HALF_CONTRAST * (2 * fine - 1)
    linear = ((encoded + 0.055) / 1.055) ** 2.4
    confidence = light_confidence(linear[..., None].repeat(3, -1), EVERYWHERE)
    assert confidence[20:44].mean() == pytest.approx(0.5, abs=0.03)
