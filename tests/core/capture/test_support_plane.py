# SPDX-License-Identifier: GPL-3.0-or-later
"""Support plane of a box on a table against the truth, and none where nothing is stood on."""

import numpy as np
from irgspp.core.capture.dense_points import find_dense_points
from irgspp.core.capture.support_plane import find_support_plane
from irgspp.core.progress.protocol import Silent
from scripts_folder import scripts_on_path

with scripts_on_path() as script:
    OBJECT = script("stresses.table_scene").OBJECT
    photographed_table = script("stresses.table_scene").photographed_table


def test_plane_is_the_table(dense, table_scene):
    plane = find_support_plane(dense, [view.camera for view in table_scene.views], 0)
    assert plane is not None
    assert plane.normal[2] > np.cos(np.radians(0.5))
    assert abs(plane.offset) < 0.01
    assert plane.noise < dense.pixel
    assert plane.over(np.array([[0.0, 0, 1], [1, 1, -1], [9, 0, 0]])).tolist() == [True, True, False]


def test_nothing_is_stood_on_without_a_table():
    scene = photographed_table((OBJECT,), count=8, width=120, table=False)
    dense = find_dense_points(scene.views, scene.points, None, 0, Silent())
    assert len(dense.points.position) > 500
    assert find_support_plane(dense, [view.camera for view in scene.views], 0) is None


def test_table_below_the_cameras_is_no_ceiling(dense, table_scene):
    """Seen from below, by cameras whose centres are mirrored, the table carries nothing."""
    below = [view.camera.moved(np.diag([1.0, 1, -1, 1])) for view in table_scene.views]
    assert find_support_plane(dense, below, 0) is None
