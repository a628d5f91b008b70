# SPDX-License-Identifier: GPL-3.0-or-later
"""Shadow of balls on a plane: its place, its darkness under simple lights, and pixels that have none."""

import dataclasses

import numpy as np
import pytest
import torch
from irgspp.core.relight.ground_shadow import over_shadow, plane_surface, shadow_alpha
from irgspp.core.relight.prepared_light import prepare_light
from irgspp.core.scene.camera import look_at
from irgspp.core.scene.lamps import Lamp

BALL = ((np.zeros(3), 1.0),)
BLACK, WHITE = (prepare_light(np.full((8, 16, 3), value, np.float32)) for value in (0.0, 1.0))
OVERHEAD = Lamp("sun")  # shines straight down
FLOOR = (0.0, 0.0, 1.0, -1.5)


@pytest.fixture(scope="module")
def above(camera):
    """Camera that looks down on the ball from aside."""
    return dataclasses.replace(camera, to_world=look_at((0.0, -6.0, 5.0), (0.0, 0.0, -1.0)))


def shadow(relighter, view, light, lamps, plane=FLOOR, **settings):
    one = relighter("mesh", balls=BALL, **settings)
    coverage = one.surface(view).coverage
    surface = plane_surface(plane, view, coverage, (0, 0, 0), 2.0)
    return shadow_alpha(one, surface, light, lamps), surface, coverage


def test_under_the_sun_the_shadow_is_the_ball_s_outline(relighter, above):
    alpha, surface, _ = shadow(relighter, above, BLACK, [OVERHEAD], denoise="off", indirect=False)
    away = surface.point[:, :2].norm(dim=1)
    values = alpha.flatten()[surface.index]
    assert torch.all(values[away < 0.97] > 0.999) and torch.all(values[away > 1.03] < 0.001) and (away < 0.97).sum() > 20


def test_under_a_white_sky_it_is_the_form_factor(relighter, above):
    """A white sky is hidden by the ball's solid angle: (r / d)^2 times the cosine, for a ball wholly above the horizon."""
    alpha, surface, _ = shadow(relighter, above, WHITE, [], samples=512, indirect=False)
    to = -surface.point
    distance = to.norm(dim=1)
    expected = (to[:, 2] / distance) / distance**2
    values = alpha.flatten()[surface.index]
    assert (values - expected).abs().mean() < 0.01 and (values - expected).abs().quantile(0.99) < 0.06


def test_bounced_light_brightens_the_shadow(relighter, above):
    alone, together = (shadow(relighter, above, WHITE, [], samples=256, indirect=indirect)[0] for indirect in (False, True))
    assert (alone - together).min() > -0.02 and (alone - together).max() > 0.05


def test_no_ground_no_shadow(relighter, above):
    dark, _, coverage = shadow(relighter, above, BLACK, [])
    assert not dark.any()
    below, surface, _ = shadow(relighter, above, WHITE, [OVERHEAD], (0.0, 0.0, -1.0, -9.0))
    assert not below.any() and not len(surface.index)
    lit, surface, _ = shadow(relighter, above, WHITE, [OVERHEAD])
    assert not lit[coverage >= 0.999].any() and (coverage.flatten()[surface.index] < 0.999).all()


def test_compositing():
    image = np.array([[[0.2, 0.2, 0.2, 0.5], [0.0, 0.0, 0.0, 0.0]]], np.float32)
    out = over_shadow(image, np.array([[0.5, 0.25]], np.float32))
    assert np.allclose(out, [[[0.2, 0.2, 0.2, 0.75], [0, 0, 0, 0.25]]])
