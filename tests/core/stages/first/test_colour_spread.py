# SPDX-License-Identifier: GPL-3.0-or-later
"""Differences of a point's colours among the views that see it."""

from dataclasses import replace

import numpy as np
import pytest
from images_in_a_ball import anchored, entered
from irgspp.core.stages.first.colour_spread import MIN_COSINE, MIN_VIEWS, colour_spread
from mirror_sphere import mirror_photographs

ORIGIN = np.zeros(3)


def points_on_sphere(count=300):
    normal = np.random.default_rng(0).normal(size=(count, 3))
    return normal / np.linalg.norm(normal, axis=1, keepdims=True)


@pytest.fixture
def cameras(camera_ring):
    return camera_ring(24, 48)


@pytest.fixture
def anchors(cameras):
    return anchored([entered(camera, ORIGIN, 1.0) for camera in cameras])


def test_it_is_the_deviation_over_the_views_that_see_a_point(cameras, anchors, sphere_dataset):
    """The plain twin: what faces a view on a convex body is seen, where the pixel's depth is known."""
    views = mirror_photographs(cameras, [view.alpha for view in sphere_dataset(cameras).train]).train
    points = points_on_sphere()
    found = colour_spread(views, anchors, points, points, 1.5)
    for point, value in zip(points, found, strict=True):
        colours = []
        for view in views:
            to_view = view.camera.centre - point
            (place,), (distance,) = view.camera.project(point[None])
            column, row = place.astype(int)
            depth = entered(view.camera, ORIGIN, 1.0)[row, column]
            facing = point @ to_view > MIN_COSINE * np.linalg.norm(to_view)
            if facing and distance < depth + 0.03 and view.alpha[row, column] > 0.99:
                colours.append(view.colour[row, column].astype(float))
        assert np.isnan(value) == (len(colours) < MIN_VIEWS)
        assert np.isnan(value) or value == pytest.approx(np.std(colours, 0).mean(), abs=1e-6)
    assert np.isfinite(found).sum() > 100


def test_chrome_differs_more_than_paint(cameras, anchors, sphere_dataset):
    painted, points = sphere_dataset(cameras).train, points_on_sphere()
    chrome = mirror_photographs(cameras, [view.alpha for view in painted]).train
    mirrored, matt = (np.nanmedian(colour_spread(views, anchors, points, points, 1.5)) for views in (chrome, painted))
    assert mirrored > 0.1 and matt < 0.01


def test_hidden_points_and_what_masks_leave_out_have_none(cameras, anchors, sphere_dataset):
    views, points = sphere_dataset(cameras).train, points_on_sphere()
    assert np.isnan(colour_spread(views, anchors, 0.9 * points, points, 1.5)).all()
    out = [replace(view, alpha=np.zeros_like(view.alpha)) for view in views]
    assert np.isnan(colour_spread(out, anchors, points, points, 1.5)).all()
    assert np.isnan(colour_spread(views[:3], anchors, points, points, 1.5)).all()
