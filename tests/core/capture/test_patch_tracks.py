# SPDX-License-Identifier: GPL-3.0-or-later
"""Patches of a box on a table are found in other photographs where exact cameras show them."""

import numpy as np
import pytest
from irgspp.core.capture.patch_tracks import MIN_VIEWS, find_patch_tracks
from irgspp.core.capture.pose_refinement import track_error
from irgspp.core.errors import Cancelled
from irgspp.core.progress.protocol import Silent


@pytest.fixture(scope="module")
def tracks(table_scene, dense):
    return find_patch_tracks(table_scene.views, dense, {}, Silent())


def test_places_fit_exact_cameras_to_a_fraction_of_a_pixel(tracks, table_scene):
    assert len(tracks.position) > 200 and np.bincount(tracks.point).min() > MIN_VIEWS
    assert track_error([view.camera for view in table_scene.views], tracks) < 0.1


def test_a_patch_has_the_colour_of_its_first_place(tracks, table_scene):
    _, first = np.unique(tracks.point, return_index=True)
    for place, colour in zip(first, tracks.colour, strict=True):
        column, row = tracks.pixel[place].astype(int)
        seen = table_scene.views[tracks.photograph[place]].colour[row, column]
        assert np.abs(255 * seen - colour).max() <= 0.5 + 1e-3


def test_no_patch_begins_on_the_background(table_scene, dense):
    left = {view.name: np.arange(view.camera.width) < view.camera.width / 2 for view in table_scene.views}
    left = {
        name: np.broadcast_to(columns, (view.camera.height, view.camera.width))
        for (name, columns), view in zip(left.items(), table_scene.views, strict=True)
    }
    found = find_patch_tracks(table_scene.views, dense, left, Silent())
    _, first = np.unique(found.point, return_index=True)
    assert len(first) > 50
    assert found.pixel[first, 0].min() >= table_scene.views[0].camera.width / 2


def test_cancelling(table_scene, dense):
    class Stopped(Silent):
        cancelled = True

    with pytest.raises(Cancelled):
        find_patch_tracks(table_scene.views, dense, {}, Stopped())
