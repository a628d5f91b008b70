# SPDX-License-Identifier: GPL-3.0-or-later
"""Reprojection errors at exact and at wrong depths of a textured plane, and against their float64 reference."""

import numpy as np
import pytest
from irgspp.core.kernels.reference.reprojection import reprojection_error_reference
from irgspp.core.stereo.reprojection import reprojection_errors

RELATIVE = 0.01
SOURCES = [[1], [0, 2], [1, 3], [2, 4], [3, 5], [4]]


@pytest.fixture(scope="module")
def depths(plane):
    return [depth.astype(np.float32) for depth in plane.depth]


def test_errors_are_as_defined(plane, depths):
    found = reprojection_errors(plane.views, depths, SOURCES, RELATIVE)
    posed = [(view.camera, depth, view.colour) for view, depth in zip(plane.views, depths, strict=True)]
    for i in (0, 2):
        expected = reprojection_error_reference(posed[i], [posed[k] for k in SOURCES[i]], RELATIVE)
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
