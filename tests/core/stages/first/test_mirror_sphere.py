# SPDX-License-Identifier: GPL-3.0-or-later
"""Spheres in hulls that views of matt surroundings carve around virtual images."""

from pathlib import Path

import numpy as np
import pytest
import torch
from irgspp.core.scene.dataset import View
from irgspp.core.stages.first.depth_anchors import COMPARED_VIEWS, DepthAnchors
from irgspp.core.stages.first.mirror_sphere import WITHIN, MirrorSphere, mirror_sphere, moved_onto

CENTRE, RADIUS, SHELL = np.array([0.1, -0.05, 0.08]), 0.3, 1.2  # of the ball, and of a matt shell around it


def entered(camera, centre, radius, far=False):
    """Planar depths (H, W) at which rays enter, or leave, a sphere; NaN where they miss it."""
    rays, offset = camera.rays().astype(float), camera.centre - centre
    a, b, c = (rays**2).sum(-1), (rays * offset).sum(-1), offset @ offset - radius**2
    root = b * b - a * c
    return np.where(root > 0, (-b + (1 if far else -1) * np.sqrt(np.maximum(root, 0))) / a, np.nan)


def seen(cameras, depths):
    """Views without pictures, and the anchors of a stereo that knows their planar depths (H, W), NaN for none."""
    views = [View("0", camera, Path("0.png"), np.zeros((camera.height, camera.width, 3), np.float32), None) for camera in cameras]
    pixels = [np.flatnonzero(np.isfinite(depth)) for depth in depths]
    begin = torch.from_numpy(np.cumsum([0, *(len(pixel) for pixel in pixels)]))
    depth = np.concatenate([one.reshape(-1)[pixel] for one, pixel in zip(depths, pixels, strict=True)]).astype(np.float32)
    joined = torch.from_numpy(np.concatenate(pixels).astype(np.int32)), torch.from_numpy(depth)
    return views, DepthAnchors(begin, *joined, torch.full((len(views), COMPARED_VIEWS), -1))


@pytest.fixture
def scene(camera_ring):
    """Views of a shell's inner side and of images in a ball, on a sphere of three quarters of its radius; and the region of the images."""
    cameras, depths, region = camera_ring(24, 96), [], []
    for camera in cameras:
        ball, shell = entered(camera, CENTRE, RADIUS), entered(camera, np.zeros(3), SHELL, far=True)
        image = entered(camera, CENTRE, 0.75 * RADIUS)
        depths.append(np.where(np.isfinite(ball), image, shell))
        region.append((camera.centre + camera.rays() * image[..., None])[np.isfinite(image)])
    return *seen(cameras, depths), np.concatenate(region)


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
    views, anchors = seen(cameras, depths)
    assert mirror_sphere(views, anchors, plate, 1.0) is None


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
