# SPDX-License-Identifier: GPL-3.0-or-later
"""Dense points of a box on a table: on their surfaces, about the point that the cameras look at."""

import numpy as np
import pytest
from irgspp.core.capture.dense_points import find_dense_points
from irgspp.core.errors import Cancelled
from irgspp.core.progress.protocol import Silent


def test_points_lie_on_the_table_and_the_box(dense):
    points = dense.points.position[np.linalg.norm(dense.points.position, axis=1) < 1.2]
    on_table = np.abs(points[:, 2]) < dense.pixel
    off_box = np.abs(np.maximum(np.abs(points - (0, 0, 0.5)) - (0.32, 0.24, 0.5), 0)).max(1) < 2 * dense.pixel
    assert len(points) > 2000
    assert (on_table | off_box).mean() > 0.95


def test_look_at_point_is_the_cameras_target(dense):
    assert dense.reliable
    assert np.allclose(dense.target, (0, 0, 0.4), atol=1e-3)
    assert dense.distance == pytest.approx(3.6, rel=1e-3)


def test_cancelling_stops_the_search(table_scene):
    class Stopped(Silent):
        cancelled = True

    with pytest.raises(Cancelled):
        find_dense_points(table_scene.views[:3], table_scene.points, None, 0, Stopped())
