# SPDX-License-Identifier: GPL-3.0-or-later
"""Free space: what views look through, on depth maps of a plane in front of a camera."""

import numpy as np
import pytest
from irgspp.core.scene.camera import Camera, look_at
from irgspp.core.stages.first.free_space import in_free_space, views_of, views_through
from irgspp.core.stereo.depth_map import DepthMap
from irgspp.core.stereo.fusion import OrientedPoints

CAMERA = Camera(24, 24, 30.0, 30.0, 12.0, 12.0, look_at(np.array([4.0, 0.0, 0.0]), np.zeros(3)))


def plane(support):
    """Depth map that has depth 4 everywhere, with this support."""
    depth = np.full((CAMERA.height, CAMERA.width), 4, np.float32)
    return DepthMap(CAMERA, depth, np.zeros((*depth.shape, 3), np.float32), depth, np.full(depth.shape, support, np.uint8), ())


def on_axis(*depths):
    """Points along the ray of the middle pixel."""
    ray = CAMERA.rays()[CAMERA.height // 2, CAMERA.width // 2].astype(np.float64)
    return np.stack([CAMERA.centre + depth * ray for depth in depths])


def test_points_before_a_depth_are_seen_through():
    assert views_through(on_axis(3.0, 3.95, 4.05, 5.0, -3.0), [plane(3)], 0.1, 2).tolist() == [1, 0, 0, 0, 0]


def test_views_see_the_points_that_lie_on_the_surface_whose_depth_they_have():
    depths = [np.full((CAMERA.height, CAMERA.width), depth, np.float32) for depth in (4, 4.05, 0)]
    assert views_of(on_axis(3.0, 3.92, 4.08, 4.3, -4.0), [CAMERA] * 3, depths, 0.1).tolist() == [0, 1, 2, 0, 0]


@pytest.mark.parametrize(("min_support", "views"), [(0, 3), (1, 2), (3, 1)])
def test_depths_count_from_their_support_on(min_support, views):
    assert views_through(on_axis(3.0), [plane(0), plane(1), plane(3)], 0.1, min_support).tolist() == [views]


def test_points_in_free_space_are_seen_through_more_often_than_seen_or_nearer_than_the_search():
    places = on_axis(3.0, 3.0, 4.0, 1.0, -1.0).astype(np.float32)
    points = OrientedPoints(places, places, places, np.array([2, 3, 2, 9, 1], np.int32))
    assert in_free_space(points, [plane(3)] * 2, [2.0, 2.0], 0.1, 2).tolist() == [True, False, False, True, False]
