# SPDX-License-Identifier: GPL-3.0-or-later
"""Reprojection errors at exact and at wrong depths of a textured plane, and against the definition in numpy."""

import numpy as np
import pytest
from irgspp.core.stereo.reprojection import reprojection_errors
from scipy.ndimage import map_coordinates

RELATIVE = 0.01
SOURCES = [[1], [0, 2], [1, 3], [2, 4], [3, 5], [4]]


@pytest.fixture(scope="module")
def depths(plane):
    return [depth.astype(np.float32) for depth in plane.depth]


def by_definition(views, depths, i, sources):
    """As `reprojection_errors` for view i."""
    view, height, width = views[i], *depths[i].shape
    points = view.camera.centre + depths[i][..., None].astype(np.float64) * view.camera.rays().astype(np.float64)
    found = []
    for k in sources:
        pixel, far = views[k].camera.project(points.reshape(-1, 3))
        column, row = np.floor(pixel).astype(int).T
        inside = (column >= 0) & (row >= 0) & (column < width) & (row < height) & (depths[i].ravel() > 0)
        seen = np.where(inside, depths[k][np.clip(row, 0, height - 1), np.clip(column, 0, width - 1)], np.inf)
        inside &= np.abs(seen - far) <= RELATIVE * far
        colour = np.stack([map_coordinates(views[k].colour[..., c], pixel.T[::-1] - 0.5, order=1, mode="nearest") for c in range(3)], -1)
        difference = np.abs(colour - view.colour.reshape(-1, 3)).mean(-1)
        found.append(np.where(inside, difference, np.nan).reshape(height, width))
    return np.nanmean(found, 0)


@pytest.mark.filterwarnings("ignore:Mean of empty slice")
def test_errors_are_as_defined(plane, depths):
    found = reprojection_errors(plane.views, depths, SOURCES, RELATIVE)
    for i in (0, 2):
        expected = by_definition(plane.views, depths, i, SOURCES[i])
        both = np.isfinite(expected) & np.isfinite(found[i])
        assert both.mean() > 0.5
        assert (np.isfinite(expected) != np.isfinite(found[i])).mean() < 2e-3  # float32 rays may round to the next pixel
        assert np.quantile(np.abs(expected - found[i])[both], 0.99) < 1e-3


def test_wrong_depth_shows_as_parallax(plane, depths):
    right = reprojection_errors(plane.views, depths, SOURCES, RELATIVE)
    wrong = reprojection_errors(plane.views, [np.float32(1.04) * depth for depth in depths], SOURCES, RELATIVE)
    assert np.nanmean(wrong[2]) > 3 * np.nanmean(right[2])


def test_hidden_points_have_no_error(plane, depths):
    """A source whose depth lies elsewhere does not see the point; pixels without depth are not compared."""
    moved = [depth if i == 0 else np.float32(0.9) * depth for i, depth in enumerate(depths)]
    assert np.isnan(reprojection_errors(plane.views, moved, SOURCES, RELATIVE)[0]).all()
    empty = [np.zeros_like(depth) for depth in depths]
    assert np.isnan(reprojection_errors(plane.views, empty, SOURCES, RELATIVE)[3]).all()
