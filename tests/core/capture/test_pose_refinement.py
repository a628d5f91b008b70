# SPDX-License-Identifier: GPL-3.0-or-later
"""Poses and focal lengths that err by half a pixel are refined on a box on a table; exact and given ones stay."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from irgspp.core.capture import pose_refinement
from irgspp.core.capture.photograph import Photograph
from irgspp.core.capture.pose_refinement import lens_of_focal_change, refine_poses, track_error
from irgspp.core.capture.reconstruction import Tracks
from irgspp.core.capture.sparse_model import PosedPhotograph, SparseModel
from irgspp.core.capture.undistortion import UndistortedImage, undistorted_pixels
from irgspp.core.datasets.parsed_dataset import Lens
from irgspp.core.errors import Cancelled
from irgspp.core.progress.protocol import Silent
from irgspp.core.scene.camera import Camera
from scipy.spatial.transform import Rotation

ERROR = 0.3  # deviation of the places of features, pixels
FOCAL = 1.01  # factor by which the focal length is wrong


def moved(camera: Camera, rng: np.random.Generator, pixels: float) -> Camera:
    """Return a camera whose image of the scene is displaced at random by about so many pixels."""
    to_world = camera.to_world.copy()
    to_world[:3, :3] = to_world[:3, :3] @ Rotation.from_rotvec(rng.normal(size=3) * pixels / camera.fx).as_matrix()
    to_world[:3, 3] += rng.normal(size=3) * 3.6 * pixels / camera.fx
    return replace(camera, to_world=to_world)


def captured(scene, pixels: float, focal: float = 1.0, features: int = 40) -> tuple[SparseModel, list[UndistortedImage]]:
    """Return photographs of the table with wrong cameras, and a model of few inexact features."""
    rng = np.random.default_rng(4)
    points = scene.points.position[rng.permutation(len(scene.points.position))[:features]].astype(np.float64)
    posed, images, tracks = [], [], []
    for i, view in enumerate(scene.views):
        wrong = replace(moved(view.camera, rng, pixels), fx=focal * view.camera.fx, fy=focal * view.camera.fy)
        lens = Lens("PINHOLE", wrong.width, wrong.height, wrong.fx, wrong.fy, wrong.cx, wrong.cy)
        photograph = Photograph(view.name, Path(view.name), Path(view.name), wrong.width, wrong.height, "lens")
        posed.append(PosedPhotograph(photograph, lens, wrong.to_world))
        images.append(UndistortedImage(posed[-1], Path(view.name), wrong, replace(view, camera=wrong, alpha=None), None))
        pixel, depth = view.camera.project(points)
        seen = np.flatnonzero(view.camera.in_image(pixel, depth))
        tracks.append((seen, np.full(len(seen), i), pixel[seen] + ERROR * rng.normal(size=(len(seen), 2))))
    point, number, place = (np.concatenate(part) for part in zip(*tracks, strict=True))
    colour = np.zeros((features, 3), np.uint8)
    model = SparseModel(posed, points, colour, point.astype(np.int32), number.astype(np.int32), place.astype(np.float32), 1.0, [])
    return model, images


def place_error(scene, images: list[UndistortedImage]) -> float:
    """Return the median error in pixels of the object's places, whose points are those that fit the cameras best."""
    corners = np.stack(np.meshgrid(*[(-1, 0, 1)] * 3), -1).reshape(-1, 3) * (0.32, 0.24, 0.5) + (0, 0, 0.5)
    true = np.concatenate([np.full(len(corners), i) for i in range(len(images))])
    pixel = np.concatenate([view.camera.project(corners)[0] for view in scene.views])
    point = np.tile(np.arange(len(corners)), len(images))
    tracks = Tracks(corners, np.zeros((len(corners), 3), np.uint8), point.astype(np.int32), true.astype(np.int32), pixel)
    return track_error([one.view.camera for one in images], tracks)


@pytest.fixture(scope="module")
def refined(table_scene, heard):
    """Photographs with wrong poses, their refinement, and what it said."""
    model, images = captured(table_scene, 0.25)
    lines = heard()
    return model, images, refine_poses(model, images, {}, 0, lines), lines


def test_wrong_poses_are_refined_in_two_rounds(table_scene, refined):
    _, images, found, lines = refined
    before, after = place_error(table_scene, images), place_error(table_scene, found.images)
    assert before > 0.4 and after < 0.12
    assert [name for name, _ in lines.phases] == ["dense points", "refine poses"] * 2
    assert any(line.startswith("poses: refined on ") for line in lines.messages)


def test_the_refined_model_holds_cameras_points_and_places_that_fit(refined):
    model, _, found, _ = refined
    better = found.model
    assert len(better.position) > 5 * len(model.position) and better.error < 0.7
    for i, (posed, image) in enumerate(zip(better.posed, found.images, strict=True)):
        assert posed is image.posed and posed.to_world == pytest.approx(image.camera.to_world)
        assert image.camera.fx == pytest.approx(image.view.camera.fx) == posed.lens.fx  # of images that are not reduced
        own = (better.track_photograph == i) & (better.track_point >= len(model.position))
        places = image.camera.project(better.position[better.track_point[own]])[0]
        assert np.median(np.linalg.norm(places - better.track_pixel[own], axis=1)) < 0.2


def test_a_wrong_focal_length_is_mended(table_scene):
    model, images = captured(table_scene, 0.1, FOCAL)
    found = refine_poses(model, images, {}, 0, Silent())
    true = table_scene.views[0].camera.fx
    assert abs(found.images[0].view.camera.fx / true - 1) < 0.3 * (FOCAL - 1)


def test_a_focal_length_that_changes_too_much_stays(table_scene, monkeypatch):
    monkeypatch.setattr(pose_refinement, "MAX_FOCAL_CHANGE", 1.001)
    model, images = captured(table_scene, 0.25, FOCAL)
    found = refine_poses(model, images, {}, 0, Silent())
    assert found.model is not model  # the poses are refined
    assert [one.view.camera.fx for one in found.images] == pytest.approx([one.view.camera.fx for one in images])


def test_exact_poses_stay_exact_and_their_dense_points_are_used_again(table_scene, heard):
    model, images = captured(table_scene, 0.0)
    lines = heard()
    found = refine_poses(model, images, {}, 0, lines)
    assert place_error(table_scene, found.images) < 0.06
    assert found.dense is not None and [name for name, _ in lines.phases] == ["dense points", "refine poses"]


def test_given_cameras_are_kept(table_scene):
    model, images = captured(table_scene, 0.25)
    found = refine_poses(replace(model, error=None), images, {}, 0, Silent())
    assert found.dense is None and all(new is old for new, old in zip(found.images, images, strict=True))


def test_photographs_without_texture_keep_their_poses(table_scene, heard):
    model, images = captured(table_scene, 0.25)
    plain = [replace(one, view=replace(one.view, colour=np.full_like(one.view.colour, 0.4))) for one in images]
    lines = heard()
    found = refine_poses(model, plain, {}, 0, lines)
    assert found.model is model
    assert lines.messages == ["poses: patches of surface fit hardly better after a refinement, so they stay as they are"]


def test_another_focal_length_leaves_the_undistorted_image_as_it_is():
    lens = Lens("OPENCV", 96, 72, 90.0, 91.0, 47.0, 37.0, (-0.08, 0.02, 0.001, -0.002, 0.003))
    pixels = np.random.default_rng(0).uniform((0, 0), (96, 72), (50, 2))
    changed = lens_of_focal_change(lens, 1.02, 1.02)
    assert undistorted_pixels(pixels, changed) == pytest.approx(undistorted_pixels(pixels, lens), abs=1e-3)
    assert changed.fx == pytest.approx(1.02 * lens.fx)


def test_cancelling(table_scene):
    class Stopped(Silent):
        cancelled = True

    with pytest.raises(Cancelled):
        refine_poses(*captured(table_scene, 0.25), {}, 0, Stopped())
