# SPDX-License-Identifier: GPL-3.0-or-later
"""Ray queries on two triangles, one behind the other."""

import numpy as np
import pytest
from irgspp.core.scene.camera import Camera, look_at
from irgspp.core.scene.triangle_tracer import TriangleTracer

CORNERS = np.array([[[-1, -1, 0], [3, -1, 0], [-1, 3, 0]], [[-5, -5, -1], [15, -5, -1], [-5, 15, -1]]], float)


@pytest.fixture(scope="module")
def tracer():
    return TriangleTracer(CORNERS)


def rays(*origins):
    origin = np.array(origins, np.float32)
    return origin, np.tile(np.array([0, 0, -2], np.float32), (len(origin), 1))


def test_rays_meet_the_first_triangle(tracer):
    found = tracer.closest(*rays((0, 0, 2), (4, -1, 2), (0, 0, -2)))
    assert found.triangle.tolist() == [0, 1, -1]
    np.testing.assert_allclose(found.distance[:2], [1, 1.5])  # in units of the direction, which is two long
    weight = np.stack([1 - found.u - found.v, found.u, found.v], 1)[:2, :, None]
    np.testing.assert_allclose((weight * CORNERS).sum(1), [[0, 0, 0], [4, -1, -1]], atol=1e-5)


def test_rays_meet_what_is_within_their_reach(tracer):
    origin, direction = rays((0, 0, 2), (0, 0, 2), (0, 0, -2))
    assert tracer.meet(origin, direction).tolist() == [True, True, False]
    assert tracer.meet(origin, direction, np.array([0.9, 1.1, 9], np.float32)).tolist() == [False, True, False]


def test_a_camera_sees_planar_depths(tracer):
    camera = Camera(9, 7, 6.0, 6.0, 4.5, 3.5, look_at((0, 0, 4), up=(0, 1, 0)))
    found = tracer.seen_by(camera)
    triangle, depth = (values.reshape(7, 9) for values in (found.triangle, found.distance))
    assert triangle[3, 4] == 0 and triangle[0, 8] == 1
    np.testing.assert_allclose(depth[triangle >= 0], 4 + triangle[triangle >= 0], rtol=1e-5)
