# SPDX-License-Identifier: GPL-3.0-or-later
"""COLMAP models, text and binary, against the dataset they were written from."""

import numpy as np
import pytest
from irgspp.core.datasets.load import load_dataset, load_dataset_cameras
from irgspp.core.datasets.up_direction import estimate_up, rotation_to_z
from irgspp.core.settings.schema import DataSettings
from PIL import Image

ALL = DataSettings(holdout=0)


def own_frame(data, points):
    """Transform points of the world to the dataset's frame."""
    inverse = np.linalg.inv(data.to_world)
    return points @ inverse[:3, :3].T + inverse[:3, 3]


@pytest.mark.parametrize("binary", [True, False])
def test_poses_points_and_colours(ball_dataset, binary):
    ball_dataset.colmap(binary)
    data = load_dataset(ball_dataset.folder, ALL)
    assert data.format == "colmap" and [v.name for v in data.train] == [f"{i:03d}" for i in range(10)]
    for view, pose in zip(data.train, ball_dataset.poses, strict=True):
        np.testing.assert_allclose(np.linalg.inv(data.to_world) @ view.camera.to_world, pose, atol=1e-9)
    np.testing.assert_allclose(own_frame(data, data.points.position), ball_dataset.surface(), atol=1e-5)
    np.testing.assert_allclose(data.points.colour, ball_dataset.colour_of(ball_dataset.surface()) / 255, atol=1e-6)


def test_points_land_on_their_colour(ball_dataset):
    ball_dataset.colmap(True)
    data = load_dataset(ball_dataset.folder, ALL)
    for view in data.train:
        pixel, depth = view.camera.project(data.points.position.astype(float))
        towards = np.linalg.norm(data.points.position - view.camera.centre, axis=-1)
        front = towards < np.quantile(towards, 0.3)
        column, row = pixel[front].astype(int).T
        assert (depth > 0).all()
        assert np.median(np.abs(view.colour[row, column] - data.points.colour[front])) < 0.03


def test_the_world_is_upright_and_the_object_at_its_origin(ball_dataset):
    tilt = np.eye(4)
    tilt[:3, :3] = rotation_to_z(np.array([0.36, -0.48, 0.8]))
    tilt[:3, 3] = 4, -3, 9
    surface = ball_dataset.surface() @ tilt[:3, :3].T + tilt[:3, 3]
    ball_dataset.poses = [tilt @ p for p in ball_dataset.poses]
    ball_dataset.colmap(True, points=surface)
    data = load_dataset(ball_dataset.folder, ALL)
    up = data.to_world[:3, :3] @ tilt[:3, :3] @ [0, 0, 1]
    assert np.degrees(np.arctan2(np.hypot(up[0], up[1]), up[2])) < 1  # the arc cosine of a rounded 1 may not exist
    assert np.linalg.norm(data.bound.centre) < 0.1 * ball_dataset.radius
    assert ball_dataset.radius < data.bound.radius < 1.35 * ball_dataset.radius
    np.testing.assert_allclose(np.linalg.svd(data.to_world[:3, :3])[1], 1, atol=1e-9)


def test_up_is_robust_to_images_in_portrait_orientation(ball_dataset):
    ball_dataset.transforms()
    cameras = [c for _, c in load_dataset_cameras(ball_dataset.folder, "all")[0]]
    turned = [c.to_world.copy() for c in cameras]
    for pose in turned[:3]:
        pose[:3, 0], pose[:3, 1] = pose[:3, 1].copy(), -pose[:3, 0].copy()
    tipped = [type(c)(c.width, c.height, c.fx, c.fy, c.cx, c.cy, p) for c, p in zip(cameras, turned, strict=True)]
    assert estimate_up(tipped)[2] > 0.999


def test_images_in_subfolders_with_masks(ball_dataset):
    names = [f"{'a' if i < 5 else 'b'}/{i % 5}.png" for i in range(10)]
    ball_dataset.colmap(True, names=names)
    for name, image in zip(names, ball_dataset.images, strict=True):
        mask = ball_dataset.folder / "masks" / name
        mask.parent.mkdir(parents=True, exist_ok=True)
        Image.fromarray(image[..., 3]).save(mask)
    data = load_dataset(ball_dataset.folder, ALL)
    assert data.has_alpha and {v.name for v in data.train} == {f"{f}_{i}" for f in "ab" for i in range(5)}
    for view, image in zip(data.train, ball_dataset.images, strict=True):
        np.testing.assert_array_equal(view.alpha, image[..., 3] / np.float32(255))


def test_downscaled_images_are_used_if_they_reach_the_resolution(ball_dataset):
    ball_dataset.colmap(False)
    for factor in (2, 4):
        folder = ball_dataset.folder / f"images_{factor}"
        folder.mkdir()
        for i, image in enumerate(ball_dataset.images):
            Image.fromarray(image[..., :3]).reduce(factor).save(folder / f"{i:03d}.png")
    for resolution, folder, width in ((800, "images", 60), (30, "images_2", 30), (20, "images_2", 20), (15, "images_4", 15)):
        view = load_dataset(ball_dataset.folder, DataSettings(resolution=resolution)).train[0]
        assert view.path.parent.name == folder and view.camera.width == width
        assert view.camera.fx == pytest.approx(ball_dataset.focal * width / 60)


def test_only_downscaled_images(ball_dataset):
    ball_dataset.colmap(True, images="images_2")
    for i, image in enumerate(ball_dataset.images):
        Image.fromarray(image[..., :3]).reduce(2).save(ball_dataset.folder / f"images_2/{i:03d}.png")
    data = load_dataset(ball_dataset.folder)
    assert data.train[0].camera.fx == pytest.approx(ball_dataset.focal / 2) and "30x24" in data.warnings[0]


def test_paths_choose_between_descriptions(ball_dataset):
    model = ball_dataset.colmap(True)
    transforms = ball_dataset.transforms()
    assert load_dataset(ball_dataset.folder).format == "colmap"  # it has points
    assert load_dataset(transforms).format == "transforms"
    assert load_dataset(model).format == load_dataset(model.parent).format == "colmap"
    (model / "points3D.bin").unlink()
    assert load_dataset(ball_dataset.folder).format == "transforms"
    assert any("points3D" in w for w in load_dataset(model).warnings)


def test_far_points_are_dropped(ball_dataset):
    points = np.concatenate([ball_dataset.surface(), [[1e6, 0, 0], [0, -1e7, 0]]])
    ball_dataset.colmap(True, points=points)
    data = load_dataset(ball_dataset.folder)
    assert len(data.points.position) == len(ball_dataset.surface()) and "2 of 302" in data.warnings[0]
    assert data.bound.radius < 1.35 * ball_dataset.radius


@pytest.mark.parametrize(
    ("model", "parameters"),
    [
        ("SIMPLE_PINHOLE", (70.0, 30.0, 24.0)),
        ("PINHOLE", (70.0, 70.0, 30.0, 24.0)),
        ("SIMPLE_RADIAL", (70.0, 30.0, 24.0, 0.1)),
        ("RADIAL", (70.0, 30.0, 24.0, 0.1, -0.02)),
        ("OPENCV", (70.0, 71.0, 30.0, 24.0, 0.1, -0.02, 0.003, -0.002)),
        ("OPENCV_FISHEYE", (70.0, 71.0, 30.0, 24.0, 0.1, -0.02, 0.003, -0.002)),
    ],
)
@pytest.mark.parametrize("binary", [True, False])
def test_every_camera_model(ball_dataset, model, parameters, binary):
    ball_dataset.colmap(binary, model, parameters)
    data = load_dataset(ball_dataset.folder)
    assert data.lenses[0].startswith(f"{model} 60x48")
    assert data.train[0].camera.cx == 30 and data.train[0].camera.fx >= 70
