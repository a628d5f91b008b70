# SPDX-License-Identifier: GPL-3.0-or-later
from types import SimpleNamespace

import numpy as np
import pytest
from irgspp.core.capture.hidden_views import hidden_views
from irgspp.core.capture.object_masks import MAX_HIDDEN_VIEWS, _hidden
from irgspp.core.capture.object_region import ObjectRegion
from irgspp.core.scene.camera import Camera, look_at
from irgspp.core.scene.dataset import Bound

STEP = 0.05
CAMERA = Camera(320, 240, 300.0, 300.0, 160.0, 120.0, look_at(np.array([0.0, -4.0, 0.0]), np.zeros(3)))


@pytest.fixture(scope="module")
def region():
    """A solid ball of radius .5 about the origin, and other things more than 1 before and behind it."""
    half = np.array([11, 50, 11])
    centre = (np.stack(np.indices(2 * half), -1) + 0.5 - half) * STEP
    label = (np.linalg.norm(centre, axis=-1) < 0.5) + 2 * (np.abs(centre[..., 1]) > 1)
    return ObjectRegion(Bound((0.0, 0.0, 0.0), 0.5), -half * STEP, STEP, label.astype(np.uint8), [])


def dense(*points):
    """Dense points at these positions."""
    return SimpleNamespace(points=SimpleNamespace(position=np.concatenate(points).astype(np.float32)))


def box(top, distance=-2.0):
    """Sparse points on a box before the lower part of the ball, up to the height `top` where the ball is."""
    x, z = np.meshgrid(np.linspace(-0.4, 0.4, 45), np.linspace(-0.4, top * (4 + distance) / 4, 45))
    kept = np.random.default_rng(0).random(x.shape) < 0.3
    return np.stack([x[kept], np.full(kept.sum(), distance), z[kept]], -1)


def test_a_thing_before_the_object_hides_it(region):
    assert hidden_views([CAMERA], dense(box(-0.2)), region) == [True]
    assert hidden_views([CAMERA], dense(box(-0.46)), region) == [False]  # all but nothing of the object


def test_things_behind_the_object_or_on_it_hide_nothing(region):
    on = region.points()[np.linalg.norm(region.points(), axis=1) > 0.45] * 1.05
    assert hidden_views([CAMERA], dense(box(0.3, 2.0), on), region) == [False]


def test_stray_points_hide_nothing(region):
    random = np.random.default_rng(1)
    stray = np.stack([random.uniform(-0.3, 0.3, 60), np.full(60, -2.0), random.uniform(-0.3, 0.3, 60)], -1)
    assert hidden_views([CAMERA], dense(stray), region) == [False]
    assert hidden_views([CAMERA], dense(box(0.0, -0.9)), region) == [False]  # too near the object to be another thing


def test_a_view_without_the_object_is_not_hidden(region):
    away = Camera(320, 240, 300.0, 300.0, 160.0, 120.0, look_at(np.array([0.0, -4.0, 0.0]), np.array([0.0, -8.0, 0.0])))
    assert hidden_views([away], dense(box(0.3)), region) == [False]


def test_given_masks_stay_and_so_do_all_where_many_views_are_hidden(region):
    behind = Camera(320, 240, 300.0, 300.0, 160.0, 120.0, look_at(np.array([0.0, 4.0, 0.0]), np.zeros(3)))

    sphere, messages = Bound((0.0, 0.0, 0.0), 0.5), []

    def hidden(few, sphere=None, given=()):
        views = [SimpleNamespace(name=f"v{i}", camera=CAMERA if i < few else behind) for i in range(8)]
        masks = dict.fromkeys(given, np.ones((240, 320)))
        return _hidden(views, dense(box(0.0)), region, sphere, masks, SimpleNamespace(message=messages.append))

    most = int(MAX_HIDDEN_VIEWS * 8)
    assert sum(hidden(most)) == most and hidden(most, given=["v0"])[0] is False and not messages
    assert not any(hidden(most + 1)) and f"in {most + 1} of 8 photographs" in messages[0]
    assert sum(hidden(most + 1, sphere, ["v0"])) == most + 1  # a person's sphere is followed
