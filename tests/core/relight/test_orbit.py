# SPDX-License-Identifier: GPL-3.0-or-later
"""Cameras of a turntable."""

import numpy as np
import pytest
from irgspp.core.errors import InputError
from irgspp.core.relight.orbit import orbit
from irgspp.core.scene.camera import Camera
from irgspp.core.scene.dataset import Bound


def template(distance):
    to_world = np.eye(4)
    to_world[:3, 3] = (1, 2, 3 + distance)
    return Camera(40, 30, 50.0, 50.0, 20.0, 15.0, to_world)


def test_cameras_look_at_the_centre_from_a_circle():
    cameras = orbit(5, [template(4), template(5), template(9)], Bound((1, 2, 3), 1.0), elevation=30)
    assert [name for name, _ in cameras] == [f"orbit_{i:03d}" for i in range(5)]
    for i, (_, camera) in enumerate(cameras):
        away = camera.centre - [1, 2, 3]
        assert np.linalg.norm(away) == pytest.approx(5)
        assert away[2] == pytest.approx(2.5)
        assert np.arctan2(away[1], away[0]) % (2 * np.pi) == pytest.approx(i * 2 * np.pi / 5)
        pixel, depth = camera.project(np.array([[1, 2, 3], [1, 2, 3.5]]))
        np.testing.assert_allclose(pixel[0], (20, 15), atol=1e-9)
        assert depth[0] == pytest.approx(5) and pixel[1, 0] == pytest.approx(20) and pixel[1, 1] < 15  # up is up
        np.testing.assert_allclose(camera.to_world[:3, :3] @ camera.to_world[:3, :3].T, np.eye(3), atol=1e-12)
        assert np.linalg.det(camera.to_world[:3, :3]) == pytest.approx(1)


def test_no_views():
    with pytest.raises(InputError, match="--orbit"):
        orbit(0, [template(1)], Bound((0, 0, 0), 1.0))
