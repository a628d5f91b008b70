# SPDX-License-Identifier: GPL-3.0-or-later
"""First planes lie between the bounds, near what is known; finer planes are the same planes of space."""

import numpy as np
import pytest
from irgspp.core.stereo.depth_map import cv_rotation
from irgspp.core.stereo.planes import Bounds, Planes, finer_planes, first_planes, rays


@pytest.fixture
def camera(camera_arc):
    return camera_arc()[2]


def bounds(camera, guess=None):
    nearest = np.full((camera.height, camera.width), 3.0, np.float32)
    nearest[:10] = 0
    nearest[10:12] = np.nan
    nearest[12:14] = 6.0  # an empty interval
    return Bounds(nearest, np.full_like(nearest, 5.0), guess)


def test_first_depths_are_uniform_in_inverse_depth(camera):
    planes = first_planes(camera, bounds(camera), None, np.random.default_rng(0))
    assert not planes.depth[:14].any()
    depth = planes.depth[14:]
    assert depth.min() >= 3 and depth.max() <= 5
    assert (1 / depth).mean() == pytest.approx((1 / 3 + 1 / 5) / 2, rel=0.01)
    assert ((planes.normal * rays(camera)).sum(-1) < 0).all() and np.allclose(np.linalg.norm(planes.normal, axis=-1), 1, atol=1e-5)


def test_points_and_guesses_attract_first_depths(camera):
    points = camera.centre + 3.5 * camera.rays()[20:60:5, ::5].reshape(-1, 3)
    near = np.abs(first_planes(camera, bounds(camera), points, np.random.default_rng(0)).depth[20:] / 3.5 - 1) < 0.06
    assert 0.75 <= near.mean() < 0.85
    guess = np.full((64, 64), 4.5, np.float32)
    guess[40:] = 0
    near = np.abs(first_planes(camera, bounds(camera, guess), None, np.random.default_rng(0)).depth / 4.5 - 1) < 0.06
    assert 0.5 <= near[14:40].mean() < 0.65 and near[40:].mean() < 0.3
    few = first_planes(camera, bounds(camera), points[:2], np.random.default_rng(0))
    assert (few.depth[14:] >= 3).all()


def test_halved_bounds_hold_those_of_their_pixels(camera):
    full = bounds(camera)
    full.nearest[30, 30], full.farthest[31, 31], full.nearest[33, 33] = 2.0, 7.0, 0.0
    half = full.halved()
    assert half.nearest[15, 15] == 2 and half.farthest[15, 15] == 7 and half.nearest[16, 16] == 3
    assert not half.searched[:7].any() and half.searched[7:].all()


def test_finer_planes_continue_coarse_ones(camera, plane):
    """A plane at half resolution is exact at full resolution too."""
    half = camera.resized(32, 32)
    normal = np.broadcast_to(plane.normal[2][0, 0] @ cv_rotation(camera), (32, 32, 3))
    offset = -(camera.centre @ plane.normal[2][0, 0])
    coarse = Planes.unmatched(offset / (normal * rays(half)).sum(-1), normal)
    wide = Bounds(np.full((64, 64), 1, np.float32), np.full((64, 64), 9, np.float32))
    fine = finer_planes(camera, wide, coarse, half, np.random.default_rng(0))
    assert np.allclose(fine.depth, plane.depth[2], rtol=1e-4)
    narrow = Bounds(np.full((64, 64), 4, np.float32), np.full((64, 64), 4.1, np.float32))
    drawn = finer_planes(camera, narrow, coarse, half, np.random.default_rng(0))
    assert drawn.depth.min() >= 4 and drawn.depth.max() <= np.float32(4.1)
