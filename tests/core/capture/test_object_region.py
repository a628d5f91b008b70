# SPDX-License-Identifier: GPL-3.0-or-later
"""Region of the object that the cameras look at, on a table with other things."""

from dataclasses import replace

import numpy as np
import pytest
from irgspp.core.capture.dense_points import find_dense_points
from irgspp.core.capture.object_region import find_object_region
from irgspp.core.capture.support_plane import find_support_plane
from irgspp.core.progress.protocol import Silent
from irgspp.core.scene.dataset import Bound
from scripts_folder import scripts_on_path

with scripts_on_path() as script:
    CLUTTER = script("stresses.table_scene").CLUTTER
    photographed_table = script("stresses.table_scene").photographed_table


@pytest.fixture(scope="module")
def plane(dense, table_scene):
    return find_support_plane(dense, [view.camera for view in table_scene.views], 0)


def test_region_is_the_box_in_the_middle(dense, plane, table_scene):
    region = find_object_region(dense, plane, [view.camera for view in table_scene.views])
    assert region is not None
    assert np.allclose(region.bound.centre, (0, 0, 0.5), atol=0.08)
    assert 0.6 < region.bound.radius < 0.85
    on_box, on_table, on_other = np.array([[0.32, 0, 0.6]]), np.array([[0.7, 0, 0.0]]), np.array([[1.15, 0.35, 0.2]])
    assert [int(region.labels(place)[0]) for place in (on_box, on_table, on_other)] == [1, 0, 2]


def test_a_foot_that_stereo_sees_apart_belongs_to_what_it_carries(dense, plane, table_scene):
    """Between foot and body is a dark gap; the other thing stands beside the body, not under it."""
    x, y, z = dense.points.position.T
    dark = (np.hypot(x, y) < 0.7) & (z > 0.2) & (z < 0.5)
    apart = replace(dense, points=dense.points.select(~dark))
    region = find_object_region(apart, plane, [view.camera for view in table_scene.views])
    assert region is not None
    body, foot, gap, other = (np.array([place]) for place in ((0.32, 0, 0.7), (0.32, 0, 0.15), (0.32, 0, 0.35), (1.15, 0.35, 0.2)))
    assert [int(region.labels(place)[0]) for place in (body, foot, gap, other)] == [1, 1, 0, 2]
    assert len(region.clutter) == 1


def test_under_an_object_that_does_not_reach_the_table_may_be_a_foot(dense, plane, table_scene):
    """Stereo sees nothing of the box's lower half."""
    cameras = [view.camera for view in table_scene.views]
    x, y, z = dense.points.position.T
    dark = (np.hypot(x, y) < 0.7) & (z > 0.05) & (z < 0.5)
    region = find_object_region(replace(dense, points=dense.points.select(~dark)), plane, cameras)
    assert region is not None
    height = plane.height(region.foot)
    assert 0 < height.min() < 2 * region.step
    assert height.max() < 0.65
    assert (np.abs(region.foot[:, :2]) < 0.45).all()
    assert (np.linalg.norm(region.foot - region.bound.centre, axis=1) < region.bound.radius).mean() > 0.95
    standing = find_object_region(dense, plane, cameras)
    assert standing is not None
    assert not len(standing.foot)


def test_other_things_are_reported(dense, plane, table_scene):
    region = find_object_region(dense, plane, [view.camera for view in table_scene.views])
    assert region is not None
    assert len(region.clutter) == 1
    assert np.linalg.norm(np.array(region.clutter[0].centre) - CLUTTER.centre) < 0.15


def test_a_sphere_chooses_another_thing(dense, plane, table_scene):
    sphere = Bound(CLUTTER.centre, 0.5)
    region = find_object_region(dense, plane, [view.camera for view in table_scene.views], sphere)
    assert region is not None
    assert region.bound == sphere
    assert np.linalg.norm(region.points().mean(0) - CLUTTER.centre) < 0.15


def test_of_two_objects_the_one_looked_at_is_taken():
    scene = photographed_table(count=10, width=120, target=(1.15, 0.55, 0.2))
    dense = find_dense_points(scene.views, scene.points, None, 0, Silent())
    cameras = [view.camera for view in scene.views]
    region = find_object_region(dense, find_support_plane(dense, cameras, 0), cameras)
    assert region is not None
    assert np.linalg.norm(np.array(region.bound.centre) - CLUTTER.centre) < 0.15
