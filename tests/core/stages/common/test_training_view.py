# SPDX-License-Identifier: GPL-3.0-or-later
"""Images prepared for the loss."""

from pathlib import Path

import numpy as np
import pytest
import torch
from irgspp.core.scene.camera import Camera
from irgspp.core.scene.dataset import View
from irgspp.core.stages.common.training_view import camera_rays, make_training_view


@pytest.fixture
def view(camera_ring):
    rng = np.random.default_rng(0)
    c = camera_ring(3)[1]
    camera = Camera(21, 15, 30.0, 28.0, 10.0, 8.0, c.to_world)
    return View("a", camera, Path("a.png"), rng.random((15, 21, 3), np.float32), rng.random((15, 21), np.float32))


def test_rays_are_the_cameras(camera_ring):
    camera = camera_ring(5, size=32)[2]
    world = torch.einsum("ij,ihw->hwj", torch.tensor(camera.world_to_cv[:3, :3]).float(), camera_rays(camera))
    assert np.allclose(world.numpy(), camera.rays(), atol=1e-5)


def test_image_is_on_black_and_the_rest_as_it_was(view):
    prepared = make_training_view(view)
    assert np.allclose(prepared.image.permute(1, 2, 0), view.colour * view.alpha[..., None])
    assert np.array_equal(prepared.alpha, view.alpha)
    assert np.allclose(prepared.world_rays.permute(1, 2, 0), view.camera.rays(), atol=1e-5)
    bare = make_training_view(View("a", view.camera, view.path, view.colour, None))
    assert bare.alpha is None and np.array_equal(bare.image.permute(1, 2, 0), view.colour)


def test_reduced_image_averages_and_its_camera_fits(view):
    prepared = make_training_view(view, 4)
    assert prepared.image.shape == (3, 3, 5) and prepared.alpha.shape == (3, 5) and prepared.camera.width == 5
    block = (view.colour * view.alpha[..., None])[4:8, 12:16].mean((0, 1))
    assert np.allclose(prepared.image[:, 1, 3], block, atol=1e-6)
    points = np.random.default_rng(1).uniform(-0.3, 0.3, (20, 3))
    full, small = view.camera.project(points)[0], prepared.camera.project(points)[0]
    assert np.allclose(small, full / 4)
    assert prepared.rays.shape == prepared.world_rays.shape == (3, 3, 5)


def test_clipped_pixels_are_lower_bounds(view):
    view.colour[3, 4], view.alpha[3, 4] = (1.0, 0.5, 0.999), 0.9
    view.colour[5, 6], view.alpha[5, 6] = (1.0, 1.0, 1.0), 0.1  # nearly transparent: does not count
    prepared = make_training_view(view)
    assert prepared.saturated[:, 3, 4].tolist() == [True, False, True] and not prepared.saturated[:, 5, 6].any()
    bounded = prepared.bounded(torch.full_like(prepared.image, 1.7))
    assert bounded[:, 3, 4].tolist() == pytest.approx([0.9, 1.7, 0.9])
    assert torch.equal(prepared.bounded(torch.zeros_like(prepared.image)), torch.zeros_like(prepared.image))
    assert (bounded[~prepared.saturated] == 1.7).all()


def test_what_is_cut_away_is_black_and_the_camera_follows(camera_ring):
    c = camera_ring(3)[1]
    camera, alpha = Camera(60, 50, 60.0, 60.0, 30.0, 25.0, c.to_world), np.zeros((50, 60), np.float32)
    alpha[20:30, 22:40] = 1
    view = View("a", camera, Path("a.png"), np.full((50, 60, 3), 0.5, np.float32), alpha)
    whole, cut = make_training_view(view), make_training_view(view, crop=True)
    assert cut.image.shape == (3, 34, 42) and cut.pixel_fraction == pytest.approx(34 * 42 / 3000) and whole.pixel_fraction == 1
    assert cut.image.sum() == whole.image.sum() and torch.equal(cut.image[:, 12:22, 12:30], whole.image[:, 20:30, 22:40])
    points = np.random.default_rng(1).uniform(-0.3, 0.3, (20, 3))
    assert np.allclose(cut.camera.project(points)[0] + (10, 8), whole.camera.project(points)[0])
    assert torch.allclose(cut.world_rays, whole.world_rays[:, 8:42, 10:52], atol=1e-5)
    empty = make_training_view(View("a", camera, view.path, view.colour, 0 * alpha), crop=True)
    assert empty.pixel_fraction == 1
