# SPDX-License-Identifier: GPL-3.0-or-later
"""Estimated bound against a ball of known position and size; look-at point; view names; description of a dataset."""

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st
from irgspp.core.datasets.bound import bound_of_cameras, bound_of_masks, find_look_at_point
from irgspp.core.datasets.load import load_dataset, load_dataset_cameras
from irgspp.core.datasets.parsed_dataset import view_names
from irgspp.core.datasets.summary import describe
from irgspp.core.datasets.up_direction import rotation_to_z
from irgspp.core.scene.camera import Camera, look_at
from irgspp.core.settings.schema import DataSettings


def test_masks_enclose_the_ball_tightly(ball_dataset):
    ball_dataset.transforms()
    bound = load_dataset(ball_dataset.folder).bound
    slack = bound.radius - np.linalg.norm(np.array(bound.centre) - ball_dataset.centre)
    assert slack > ball_dataset.radius and bound.radius < 1.35 * ball_dataset.radius


def test_one_bad_mask_does_not_break_the_bound(ball_dataset):
    rng = np.random.default_rng(0)
    more = [*ball_dataset.poses, *ball_dataset.poses, *ball_dataset.poses]
    ball_dataset.images = [p.copy() for _ in range(3) for p in ball_dataset.images]
    ball_dataset.poses = [p + np.pad(rng.normal(0, 1e-6, (3, 1)), ((0, 1), (3, 0))) for p in more]
    ball_dataset.images[4][..., 3] = 0
    ball_dataset.images[4][:6, :6, 3] = 255
    ball_dataset.transforms()
    bound = load_dataset(ball_dataset.folder, DataSettings(holdout=0)).bound
    assert np.linalg.norm(np.array(bound.centre) - ball_dataset.centre) < 0.15 and 1 < bound.radius / ball_dataset.radius < 1.35


def turntable(count, distance, height=0.0, focal=48.0):
    """Cameras of 48 x 48 pixels on a circle, `height` is the sine of its elevation."""
    angle = 2 * np.pi * np.arange(count) / count
    level = np.sqrt(1 - height**2)
    places = distance * np.stack([level * np.cos(angle), level * np.sin(angle), np.full(count, height)], -1)
    return [Camera(48, 48, focal, focal, 24.0, 24.0, look_at(place)) for place in places]


def masked_bound(views):
    cameras = [v.camera for v in views]
    bound = bound_of_masks(cameras, [v.alpha for v in views], bound_of_cameras(cameras))
    return np.array(bound.centre), bound.radius


@pytest.mark.parametrize("height", [0.0, 0.35])
@pytest.mark.parametrize(("count", "distance"), [(6, 4.0), (12, 3.0), (12, 4.0), (24, 3.0)])
def test_cells_near_the_cameras_of_a_turntable_are_carved(sphere_dataset, count, distance, height):
    """The unit sphere; of a pixel's width, 0.08, masks, cells and margin add about two."""
    centre, radius = masked_bound(sphere_dataset(turntable(count, distance, height)).train)
    assert np.linalg.norm(centre) < 0.25 and 1 + np.linalg.norm(centre) < radius < 1.5


@pytest.mark.parametrize("count", [8, 12, 48])
def test_a_half_dome_of_views_bounds_the_ball(sphere_dataset, camera_ring, count):
    centre, radius = masked_bound(sphere_dataset(camera_ring(count, 48, lowest=0.05, highest=0.95)).train)
    assert np.linalg.norm(centre) < 0.25 and 1 + np.linalg.norm(centre) < radius < 1.5


def test_views_that_cut_the_ball_do_not_cut_its_bound(sphere_dataset):
    """Close-ups, whose masks reach the border, say nothing about what is outside their images."""
    views = sphere_dataset([*turntable(12, 4.0), *turntable(24, 3.0, 0.35, focal=90.0)]).train
    assert max(v.alpha[0].max() for v in views) == 1
    centre, radius = masked_bound(views)
    assert np.linalg.norm(centre) < 0.25 and 1 + np.linalg.norm(centre) < radius < 1.5


def test_contradicting_masks_give_a_warning(ball_dataset):
    for i, image in enumerate(ball_dataset.images):
        image[..., 3] = 0
        image[:8, (0 if i % 2 else 52) : (8 if i % 2 else 60), 3] = 255
    ball_dataset.transforms()
    assert any("masks" in w for w in load_dataset(ball_dataset.folder).warnings)


def test_bound_from_cameras_alone(ball_dataset):
    ball_dataset.transforms(alpha=False)
    data = load_dataset(ball_dataset.folder)
    np.testing.assert_allclose(data.bound.centre, ball_dataset.centre, atol=0.02)
    assert 0.5 < data.bound.radius < 1.2


def test_bound_from_points_in_front_of_a_wall(ball_dataset):
    rng = np.random.default_rng(3)
    wall = ball_dataset.centre + np.stack([rng.uniform(-6, 6, 400), np.full(400, 4.0), rng.uniform(-3, 3, 400)], -1)
    ball_dataset.colmap(True, points=np.concatenate([ball_dataset.surface(), wall]))
    data = load_dataset(ball_dataset.folder)
    own = np.linalg.inv(data.to_world) @ [*data.bound.centre, 1]
    assert np.linalg.norm(own[:3] - ball_dataset.centre) < 0.1 and 0.95 < data.bound.radius / ball_dataset.radius < 1.35


def test_a_given_bound_is_in_the_datasets_own_frame(ball_dataset):
    ball_dataset.colmap(True)
    data = load_dataset(ball_dataset.folder, DataSettings(centre=tuple(ball_dataset.centre + 0.1), radius=0.7))
    own = np.linalg.inv(data.to_world) @ [*data.bound.centre, 1]
    np.testing.assert_allclose(own[:3], ball_dataset.centre + 0.1, atol=1e-9)
    assert data.bound.radius == pytest.approx(0.7)


def test_cameras_that_look_outwards_give_a_warning(ball_dataset):
    for pose in ball_dataset.poses:
        pose[:3, [0, 2]] *= -1
    ball_dataset.transforms(alpha=False)
    data = load_dataset(ball_dataset.folder)
    assert any("look at one point" in w for w in data.warnings)


def test_look_at_point_is_robust_to_a_stray_camera(ball_dataset):
    ball_dataset.poses[0][:3, 3] += ball_dataset.poses[0][:3, 0] * 2
    ball_dataset.transforms()
    cameras = [c for _, c in load_dataset_cameras(ball_dataset.folder, "all")[0]]
    target = find_look_at_point(cameras)
    assert target.reliable and np.linalg.norm(target.point - ball_dataset.centre) < 0.1


@given(st.tuples(*[st.floats(-1, 1)] * 3).filter(lambda v: np.linalg.norm(v) > 0.1))
@example((0.0, 3e-6, -1.0))
@example((1e-14, -1e-9, -1.0))
@example((0.0, 0.0, -1.0))
def test_the_rotation_takes_up_to_z(direction):
    up = np.array(direction) / np.linalg.norm(direction)
    turn = rotation_to_z(up)
    np.testing.assert_allclose(turn @ up, [0, 0, 1], atol=1e-6)
    np.testing.assert_allclose(turn @ turn.T, np.eye(3), atol=1e-6)
    assert np.linalg.det(turn) > 0


def test_names():
    assert view_names(["./test/r_0/rgba", "train/r_001.png", "a\\b.JPG"]) == ["r_0", "r_001", "b"]
    assert view_names(["x/a/1.png", "x/b/1.png", "y/2.png"]) == ["a_1", "b_1", "2"]
    assert view_names(["1.png", "1.jpg", "1.png"]) == ["1", "1_2", "1_3"]
    assert view_names(["frame.0001", "rgba.png"]) == ["frame.0001", "rgba"]


@given(st.lists(st.text(alphabet="ab/._12", min_size=1, max_size=8), max_size=12))
def test_names_are_unique_and_safe(listed):
    names = view_names(listed)
    assert len(set(names)) == len(names) == len(listed)
    assert all("/" not in n and n not in ("", ".", "..") for n in names)


def test_description(ball_dataset):
    ball_dataset.colmap(True, "OPENCV", (70.0, 70.0, 30.0, 24.0, 0.1, 0, 0, 0))
    (ball_dataset.folder / "images/007.png").unlink()
    text = describe(load_dataset(ball_dataset.folder))
    for words in ("colmap", "7 training, 2 test", "OPENCV 60x48", "k1 0.1", "300", "007.png", "none"):
        assert words in text
