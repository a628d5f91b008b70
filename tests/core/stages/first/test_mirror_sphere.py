# SPDX-License-Identifier: GPL-3.0-or-later
"""Spheres in hulls that views of matt surroundings carve around virtual images."""

import numpy as np
import pytest
import torch
from images_in_a_ball import CENTRE, RADIUS, SHELL, anchored, blank, entered, images_in_a_ball
from irgspp.core.stages.first.depth_anchors import DepthAnchors
from irgspp.core.stages.first.mirror_sphere import WITHIN, MirrorSphere, mirror_sphere, moved_onto


@pytest.fixture
def scene(camera_ring):
    return images_in_a_ball(camera_ring(24, 96))


def test_the_ball_is_found_from_images_inside_it(scene):
    sphere = mirror_sphere(*scene, radius=1.0)
    assert sphere is not None
    assert np.linalg.norm(sphere.centre - CENTRE) < 0.1 * RADIUS
    assert abs(sphere.radius / RADIUS - 1) < 0.1


def test_nothing_is_a_ball_where_no_view_sees_behind_it(scene):
    views, anchors, region = scene
    none = DepthAnchors(torch.zeros_like(anchors.begin), anchors.pixel[:0], anchors.depth[:0], anchors.witnesses)
    assert mirror_sphere(views, none, region, 1.0) is None


def test_a_sheet_is_no_ball(camera_ring):
    """Two layers of a plate in front of a shell: its hull is a plate."""
    steps, cameras, depths = np.linspace(-0.4, 0.4, 60), camera_ring(24, 96), []
    plate = np.stack(np.meshgrid(steps, steps, [-0.02, 0.02]), -1).reshape(-1, 3)
    for camera in cameras:
        rays = camera.rays().astype(float)
        distance = -camera.centre[2] / rays[..., 2]
        at = camera.centre + rays * distance[..., None]
        on_plate = (np.abs(at[..., :2]) < 0.4).all(-1) & (distance > 0)
        depths.append(np.where(on_plate, distance, entered(camera, np.zeros(3), SHELL, far=True)))
    assert mirror_sphere(blank(cameras), anchored(depths), plate, 1.0) is None


def test_surfels_in_a_sphere_are_moved_onto_it_and_face_outwards(some_gaussians):
    g = some_gaussians(200, 3)
    points = g.position.T.double().numpy()
    sphere = MirrorSphere(np.array([0.1, 0.0, 0.0]), float(np.quantile(np.linalg.norm(points - [0.1, 0, 0], axis=1), 0.5)))
    held, moved = sphere.holds(points), moved_onto(g, [sphere])
    assert 50 < held.sum() < 190
    offset = moved.position.T.double().numpy()[held] - sphere.centre
    distance = np.linalg.norm(offset, axis=1)
    assert np.allclose(distance, sphere.radius, rtol=1e-5)
    assert np.allclose((moved.normals().T.numpy()[held] * offset).sum(1) / distance, 1, atol=1e-4)
    assert torch.equal(moved.position[:, ~held], g.position[:, ~held]) and torch.equal(moved.quaternion[:, ~held], g.quaternion[:, ~held])
    assert torch.equal(moved.opacity, g.opacity) and sphere.holds(moved.position.T.double().numpy())[held].all() and WITHIN > 1
