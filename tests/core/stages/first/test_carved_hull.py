# SPDX-License-Identifier: GPL-3.0-or-later
"""Hulls that views of matt surroundings carve around virtual images."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from images_in_a_ball import CENTRE, IMAGES, RADIUS, images_in_a_ball
from irgspp.core.stages.first.carved_hull import carve_hull
from irgspp.core.stages.first.depth_anchors import DepthAnchors


@pytest.fixture
def scene(camera_ring):
    return images_in_a_ball(camera_ring(24, 96))


def test_the_hull_of_images_in_a_ball_is_the_ball(scene):
    hull = carve_hull(*scene, radius=1.0)
    assert hull.has_surface
    place, normal = hull.surface()
    outwards = (place - CENTRE) / np.linalg.norm(place - CENTRE, axis=1, keepdims=True)
    distance = np.linalg.norm(place - CENTRE, axis=1)
    # The ring of views leaves caps at the hull's two ends.
    assert abs(np.median(distance) / RADIUS - 1) < 0.05
    assert np.median((normal * outwards).sum(1)) > 0.97
    assert np.allclose(np.linalg.norm(normal, axis=1), 1, atol=1e-6)
    assert len(place) * hull.side**2 == pytest.approx(4 * np.pi * RADIUS**2, rel=0.5)


def test_depth_is_the_distance_to_the_surface(scene):
    hull = carve_hull(*scene, radius=1.0)
    assert np.median(hull.depth(scene[2])) == pytest.approx((1 - IMAGES) * RADIUS, abs=0.15 * RADIUS)
    out = CENTRE + np.array([[1.04, 0, 0], [0, -1.04, 0], [0.0, 0, 0]]) * RADIUS
    assert (hull.depth(out)[:2] < 0.01 * RADIUS).all()
    assert hull.depth(out)[2] > 0.8 * RADIUS


def test_masks_carve_as_well(scene):
    views, anchors, region = scene
    none = DepthAnchors(torch.zeros_like(anchors.begin), anchors.pixel[:0], anchors.depth[:0], anchors.witnesses)
    assert not carve_hull(views, none, region, 1.0).has_surface
    masked_views = []
    for view in views:
        column, row = view.camera.project(region)[0].astype(int).T
        alpha = np.zeros(view.colour.shape[:2], np.float32)
        alpha[row, column] = 1
        masked_views.append(replace(view, alpha=alpha))
    masked = carve_hull(masked_views, none, region, 1.0)
    assert masked.has_surface
    assert np.median(masked.depth(region)) < 0.1 * RADIUS
