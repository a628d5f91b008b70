# SPDX-License-Identifier: GPL-3.0-or-later
"""False holes of masks: filled where they have the object's colours, the other views see it, and no texture of the table is known."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from irgspp.core.capture.false_holes import holes_like_object, without_false_holes
from irgspp.core.capture.second_cut import cut_again
from irgspp.core.scene.dataset import View
from patterned_table import BOUND, PLANE, cameras, on_table, photographs

BALL = np.float32([0.62, 0.6, 0.58])
HIDDEN = 0.045  # distance from the ball's foot, where the table is hidden in most photographs or in all
SCALE = 5  # of the photographs: a hole must be wider than the errors of a mask's edge


@pytest.fixture(scope="module")
def scene():
    """Views of a plain ball with true masks, and a hole (H, W) in each mask, in front of the table that the ball hides."""
    cams = [
        replace(c, width=SCALE * c.width, height=SCALE * c.height, fx=SCALE * c.fx, fy=SCALE * c.fy, cx=SCALE * c.cx, cy=SCALE * c.cy)
        for c in cameras(16)
    ]
    photos, masks = photographs(cams, BALL)
    views = [View(f"v{i}", c, Path("v.png"), p, m, mask_error=1.0) for i, (c, p, m) in enumerate(zip(cams, photos, masks, strict=True))]
    return views, [np.hypot(*on_table(camera)) < HIDDEN for camera in cams]


def with_holes(views, holes, count):
    """The views, of which the first have holes."""
    return [
        replace(view, alpha=np.where(hole, np.float32(0), view.alpha)) if i < count else view
        for i, (view, hole) in enumerate(zip(views, holes, strict=True))
    ]


def rendered(views):
    """Renderings of what is fitted to such masks: the ball, with their holes."""
    return [(np.broadcast_to(BALL, view.colour.shape).astype(np.float32), view.alpha.astype(np.float32)) for view in views]


def filled(views, holes):
    """Fraction of the holes' pixels that the masks of views contain."""
    return [float((view.alpha[hole] > 0.5).mean()) for view, hole in zip(views, holes, strict=True)]


def test_holes_of_a_few_views_are_filled(scene):
    views, holes = scene
    damaged = with_holes(views, holes, 2)
    assert filled(damaged, holes)[:2] == [0, 0]
    assert min(filled(cut_again(damaged, rendered(damaged), PLANE, BOUND), holes)) > 0.95


def test_a_hole_that_several_views_look_through_stays(scene):
    """Four photographs from one place agree on it: other views that see no object there are evidence of a true hole."""
    views, holes = scene
    views, holes = views[:1] * 4 + views[1:], holes[:1] * 4 + holes[1:]
    numbers = [hole.astype(np.int32) for hole in holes]
    for count, expected in ((1, 1.0), (4, 0.0)):
        found = without_false_holes(with_holes(views, holes, count), numbers, BOUND, PLANE)
        assert filled(found, holes)[:count] == [expected] * count


def test_views_without_holes_stay_as_they_are(scene):
    views, holes = scene
    found = without_false_holes(views, [np.zeros(hole.shape, np.int32) for hole in holes], BOUND, PLANE)
    assert all(one is view for one, view in zip(found, views, strict=True))


def test_colours_and_table_tell_which_holes_may_be_false():
    mask, evidence, textured = np.ones((12, 40), np.float32), np.full((12, 40), -2.0), np.zeros((12, 40), bool)
    for column in (4, 14, 24, 34):
        mask[4:8, column : column + 4] = 0
    evidence[4:8, 14:18] = 1.0  # not the object's colours
    textured[4:8, 24:28] = True  # the table is known there
    mask[:8, 36] = 0  # open to the outside: no hole
    found = holes_like_object(mask, evidence, textured)
    assert sorted(np.flatnonzero(found[5])) == [4, 5, 6, 7]
    assert not holes_like_object(np.ones((12, 40)), evidence, textured).any()
