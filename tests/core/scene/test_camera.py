# SPDX-License-Identifier: GPL-3.0-or-later
"""A pinhole camera's geometry."""

import numpy as np
import pytest
from irgspp.core.scene.camera import Camera, look_at

RANDOM = np.random.default_rng(0)


@pytest.fixture
def camera() -> Camera:
    to_world = np.eye(4)
    to_world[:3, :3] = np.linalg.qr(RANDOM.normal(size=(3, 3)))[0]
    to_world[:3, :3] *= np.linalg.det(to_world[:3, :3])
    to_world[:3, 3] = [0.3, -2.0, 1.0]
    return Camera(31, 17, 40.0, 44.0, 14.0, 9.5, to_world)


def test_points_on_a_pixels_ray_fall_on_its_centre(camera):
    points = camera.centre + 2.5 * camera.rays().astype(np.float64)
    pixel, depth = camera.project(points.reshape(-1, 3))
    x, y = np.meshgrid(np.arange(31) + 0.5, np.arange(17) + 0.5)
    assert np.allclose(pixel, np.stack([x, y], -1).reshape(-1, 2), atol=1e-4)
    assert np.allclose(depth, 2.5)


def test_axes(camera):
    """Forward is the middle of the image, up is towards row 0, right towards the last column."""
    for move, sign in ((camera.to_world[:3, 0], (1, 0)), (camera.to_world[:3, 1], (0, -1))):
        (a, b), _ = camera.project(np.stack([camera.centre + 3 * camera.forward, camera.centre + 3 * camera.forward + 0.1 * move]))
        assert np.allclose(a, [14.0, 9.5])
        assert np.array_equal(np.sign(np.round(b - a, 6)), sign)


def test_points_behind_have_negative_depth(camera):
    assert camera.project((camera.centre - camera.forward)[None])[1] == pytest.approx(-1)


def test_the_projection_matrix_projects(camera):
    points = RANDOM.uniform(-1, 1, (20, 3))
    pixel, depth = camera.project(points)
    x, y, d = camera.projection @ np.concatenate([points, np.ones((20, 1))], 1).T
    np.testing.assert_allclose(d, depth, atol=1e-12)
    np.testing.assert_allclose(np.stack([x / d, y / d], 1), pixel, atol=1e-9)


def test_points_inside_the_image_are_those_of_its_pixels(camera):
    pixel = np.array([[0, 0], [30.99, 16.99], [31, 5], [5, 17], [-0.01, 5], [5, -0.01], [5, 5]])
    depth = np.array([1, 1, 1, 1, 1, 1, -1.0])
    assert camera.in_image(pixel, depth).tolist() == [True, True] + 5 * [False]
    assert camera.in_image(pixel, depth, margin=1).tolist() == 6 * [True] + [False]
    assert not camera.in_image(pixel, depth, margin=-0.5)[:2].any()


def test_a_cropped_camera_sees_the_same(camera):
    points = camera.centre + camera.rays().reshape(-1, 3)
    cropped = camera.cropped(4, 3, 10, 8)
    assert (cropped.width, cropped.height) == (10, 8)
    np.testing.assert_array_equal(cropped.rays(), camera.rays()[3:11, 4:14])
    assert np.allclose(cropped.project(points)[0], camera.project(points)[0] - (4, 3))


def test_a_resized_camera_sees_the_same(camera):
    points = camera.centre + camera.rays().reshape(-1, 3)
    assert np.allclose(camera.resized(62, 51).project(points)[0], camera.project(points)[0] * [2, 3])


@pytest.mark.parametrize("side", [7, 400])
def test_the_longest_side_is_as_given(camera, side):
    changed = camera.with_longest_side(side)
    shorter = round(side * min(camera.width, camera.height) / max(camera.width, camera.height))
    assert (max(changed.width, changed.height), min(changed.width, changed.height)) == (side, max(1, shorter))
    assert changed.fx / changed.width == pytest.approx(camera.fx / camera.width)


def test_a_camera_moves_with_a_similarity_of_the_world(camera):
    similarity = np.eye(4)
    similarity[:3, :3] = 2 * np.array([[0, -1, 0], [1, 0, 0], [0, 0, 1]])
    similarity[:3, 3] = [1, 2, 3]
    moved = camera.moved(similarity)
    assert np.allclose(moved.to_world[:3, :3] @ moved.to_world[:3, :3].T, np.eye(3))
    points = RANDOM.uniform(-1, 1, (20, 3))
    before, depth = camera.project(points)
    after, further = moved.project(points @ similarity[:3, :3].T + similarity[:3, 3])
    assert np.allclose(before, after) and np.allclose(2 * depth, further)


@pytest.mark.parametrize("eye", [(2.0, -1.0, 0.5), (0.0, 0.0, 3.0), (1.0, 2.0, -4.0)])
@pytest.mark.parametrize("up", [(0.0, 0.0, 1.0), (0.3, -0.1, 2.0), (1.0, 0.0, 0.0)])
def test_a_camera_looks_at_its_target_upright(eye, up):
    target = np.array([0.0, 0.0, 0.2])
    camera = Camera(31, 17, 40.0, 44.0, 14.0, 9.5, look_at(eye, target, up))
    rotation = camera.to_world[:3, :3]
    assert np.allclose(rotation.T @ rotation, np.eye(3)) and np.linalg.det(rotation) == pytest.approx(1)
    assert np.array_equal(camera.centre, eye)
    (middle,), (depth,) = camera.project(target[None])
    assert np.allclose(middle, [14.0, 9.5]) and depth == pytest.approx(np.linalg.norm(target - eye))
    (above,), _ = camera.project((target + 0.01 * np.array(up))[None])
    along_up = np.allclose(np.cross(up, target - eye), 0)
    assert above == pytest.approx(middle) if along_up else above[0] == pytest.approx(14) and above[1] < 9.5
