# SPDX-License-Identifier: GPL-3.0-or-later
"""Surfels on the parts of a sphere that no view shows."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from irgspp.core.rendering.gbuffer_cache import GBufferCache
from irgspp.core.scene.camera import Camera, look_at
from irgspp.core.stages.second.unseen_surface import hidden, with_unseen_surface

OPEN_BELOW = -0.7  # z under which the sphere has no surfels


def camera(eye, size=160):
    return Camera(size, size, 1.5 * size, 1.5 * size, size / 2, size / 2, look_at(eye, (0, 0, 0)))


FROM_ABOVE = [camera((3 * np.cos(a), 3 * np.sin(a), 1.5)) for a in np.linspace(0, 2 * np.pi, 6, endpoint=False)]
FROM_BELOW = camera((0.3, 0.2, -3.0))


@pytest.fixture
def opened(sphere):
    """The sphere without its lowest part, and the closed surface."""
    make, surface = sphere
    whole = make()
    gaussians = whole.gaussians.select(whole.gaussians.position[2] > OPEN_BELOW)
    upper = gaussians.position[2] > -0.4  # what is far from the gap looks different
    gaussians.material[0] = torch.where(upper, -2.0, 1.0)
    gaussians.sh[0] = torch.where(upper, 0.0, 0.5)
    return replace(whole, gaussians=gaussians), surface


def test_gap_that_no_view_shows_is_closed(opened):
    start, surface = opened
    found = with_unseen_surface(start, surface, GBufferCache(start, FROM_ABOVE), 0)
    before = start.gaussians.count
    new = found.gaussians.select(torch.arange(before, found.gaussians.count))
    assert new.count > 50 and (new.position[2] < OPEN_BELOW).all()
    assert torch.allclose(found.gaussians.position[:, :before], start.gaussians.position)
    assert torch.allclose(new.position.norm(dim=0), torch.ones(new.count), atol=0.02)
    assert ((new.normals() * new.position).sum(0).abs() > 0.99).all()
    views = [GBufferCache(one, [FROM_BELOW])[0] for one in (start, found)]
    assert views[0].depth[80, 80] > 3.5 and views[1].depth[80, 80] == pytest.approx(2.0, abs=0.1)


def test_new_surfels_look_like_the_nearest(opened):
    start, surface = opened
    found = with_unseen_surface(start, surface, GBufferCache(start, FROM_ABOVE), 0)
    new = found.gaussians.select(torch.arange(start.gaussians.count, found.gaussians.count))
    assert torch.allclose(new.material[0], torch.ones(new.count)) and torch.allclose(new.sh[0], torch.full((3, new.count), 0.5), atol=1e-5)
    assert not new.sh[1:].any()


def test_gap_that_a_view_shows_stays_open(opened):
    start, surface = opened
    found = with_unseen_surface(start, surface, GBufferCache(start, [*FROM_ABOVE, FROM_BELOW]), 0)
    assert found is start


def test_surface_without_gaps_stays_as_it_is(sphere):
    make, surface = sphere
    whole = make()
    assert with_unseen_surface(whole, surface, GBufferCache(whole, FROM_ABOVE), 0) is whole


def test_points_are_hidden_behind_the_surfels_or_outside_the_image(sphere):
    view = GBufferCache(sphere[0](), [camera((0.0, -3.0, 0.0))])[0]
    points = np.array([[0, -1.1, 0], [0, -0.99, 0], [0, 0, 0], [0, 1, 0], [0.95, 0, 0.95], [0, 0, 40.0], [0, -4.0, 0]])
    assert hidden(points, view, 0.05).tolist() == [False, False, True, True, False, True, True]


def test_points_near_the_outline_are_not_hidden(sphere):
    """Behind the sphere, 12 pixels inside its outline and 3: there a surfel would stick out."""
    view = GBufferCache(sphere[0](), [camera((0.0, -3.0, 0.0))])[0]
    outline = np.flatnonzero(np.diag(view.alpha) >= 0.5).max()  # along the image's diagonal, right and down
    pixel = outline + 0.5 - np.array([12, 3]) / 2**0.5
    points = np.array([[(at - 80) / 240 * 4, 1.0, (80 - at) / 240 * 4] for at in pixel])  # at depth 4
    assert hidden(points, view, 0.05).tolist() == [True, False]
