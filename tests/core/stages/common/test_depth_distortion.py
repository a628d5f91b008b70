# SPDX-License-Identifier: GPL-3.0-or-later
"""Depth distortion against the sum over pairs of surfels."""

import numpy as np
import torch
from irgspp.core.kernels.rasterize import rasterize
from irgspp.core.scene.camera import Camera, look_at
from irgspp.core.scene.gaussians import surfels
from irgspp.core.stages.common.depth_distortion import depth_distortion, depth_moments

CAMERA = Camera(9, 9, 30.0, 30.0, 4.5, 4.5, look_at((0.0, 0.0, 3.0), (0.0, 0.0, 0.0), (0.0, 1.0, 0.0)))
CENTRE, RADIUS = np.array([0.0, 0.0, 0.3]), 2.0


def rendered(*heights, opacity=0.6):
    """Moments and opacity of large surfels that face the camera at some heights, and the surfels."""
    points = np.array([(0.0, 0.0, height) for height in heights])
    up = np.tile((0.0, 0.0, 1.0), (len(points), 1))
    g = surfels(points, up, np.ones_like(points), np.full(len(points), 50.0), opacity)
    g.position.requires_grad_()
    extra = depth_moments(g, CAMERA, CENTRE, RADIUS)
    sums, _ = rasterize(g.position, g.quaternion, g.log_scale, g.opacity, g.sh, extra, CAMERA, RADIUS, 0)
    return sums[6:8], sums[-1], g


def test_it_is_the_sum_over_pairs_of_weights_and_squared_differences():
    heights, opacity = (0.7, 0.2, -0.4), 0.6
    with torch.no_grad():
        moments, alpha, _ = rendered(*heights, opacity=opacity)
    weight = [opacity * (1 - opacity) ** i for i in range(3)]  # front to back
    pairs = [(i, j) for j in range(3) for i in range(j)]
    expected = sum(weight[i] * weight[j] * ((heights[i] - heights[j]) / RADIUS) ** 2 for i, j in pairs)
    assert abs(float(depth_distortion(moments, alpha)) / expected - 1) < 1e-2


def test_one_surface_has_none_and_two_are_drawn_together():
    with torch.no_grad():
        moments, alpha, _ = rendered(0.5)
    assert abs(float(depth_distortion(moments, alpha))) < 1e-6
    moments, alpha, g = rendered(0.5, 0.1)
    depth_distortion(moments, alpha).backward()
    assert g.position.grad is not None and g.position.grad[2, 0] > 0 > g.position.grad[2, 1]
