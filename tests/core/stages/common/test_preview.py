# SPDX-License-Identifier: GPL-3.0-or-later
"""Preview images: small, correct, and without effect on the optimisation."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from irgspp.core.io.srgb import encode_srgb
from irgspp.core.progress.protocol import Silent
from irgspp.core.scene.dataset import Bound
from irgspp.core.scene.gaussians import surfels
from irgspp.core.scene.reconstruction import Reconstruction
from irgspp.core.scene.surface import Surface
from irgspp.core.settings.overrides import with_overrides
from irgspp.core.settings.schema import preset
from irgspp.core.stages.common.preview import MAX_POINTS, albedo_image, points_shape, preview_camera, surface_shape
from irgspp.core.stages.first.train import train

SMALL = ("first.iterations=12", "first.gaussians=400", "first.light_height=16", "materials=low-gloss")


class Looker(Silent):
    """Progress that draws every image and samples every shape that is offered."""

    def __init__(self):
        self.images, self.shapes = [], []

    def image(self, draw):
        self.images.append(draw())

    def shape(self, sample, at_once=False):
        self.shapes.append(sample())


def test_looking_does_not_change_the_fit(sphere_dataset, camera_ring):
    dataset, settings, looker = sphere_dataset(camera_ring(9, 32)), with_overrides(preset("draft"), SMALL), Looker()
    (alone, _), (watched, _) = train(dataset, settings), train(dataset, settings, looker)
    for name in ("position", "quaternion", "sh", "material", "opacity"):
        assert torch.equal(getattr(alone.gaussians, name), getattr(watched.gaussians, name))
    assert len(looker.images) == 12
    image = looker.images[-1]
    assert image.shape == (32, 32, 3) and image.dtype == np.uint8
    view = dataset.train[0]
    inside, outside = view.alpha == 1, view.alpha == 0
    assert np.abs(image[inside] / 255 - view.colour[inside]).mean() < 0.15
    assert image[outside].mean() < 40
    assert len(looker.shapes) == 13  # once before the first step
    shape = looker.shapes[-1]
    distance = np.linalg.norm(shape["position"] - shape["centre"], axis=1)
    assert 100 < len(distance) <= 400 and abs(np.median(distance) - 1) < 0.2  # the sphere
    assert shape["colour"].shape == shape["position"].shape and shape["colour"].min() >= 0 and shape["colour"].max() <= 1
    assert np.array_equal(shape["to_world"], dataset.to_world) and "faces" not in shape


def test_points_are_few_opaque_and_inside_the_bound(sphere_dataset, camera_ring):
    dataset = replace(sphere_dataset(camera_ring(3, 16)), bound=Bound((0.0, 0.0, 0.0), 2.0))
    position = np.random.default_rng(0).normal(size=(3 * MAX_POINTS, 3)).astype(np.float32)
    position[:100] *= 50  # beyond the bound
    opacity = np.where(np.arange(len(position)) % 2, 0.9, 0.1)
    gaussians = surfels(
        position, np.tile([[0.0, 0.0, 1.0]], (len(position), 1)), np.full_like(position, 0.25), np.ones(len(position)), opacity
    )
    shape = points_shape(gaussians, dataset)
    assert 0.5 * MAX_POINTS < len(shape["position"]) <= MAX_POINTS
    assert np.linalg.norm(shape["position"], axis=1).max() < 2
    np.testing.assert_allclose(shape["colour"], encode_srgb(0.25), atol=1e-5)
    np.testing.assert_array_equal(shape["position"], shape["position"][np.isin(shape["position"][:, 0], position[opacity > 0.5][:, 0])])
    nothing = points_shape(replace(gaussians, opacity=gaussians.opacity - 9), dataset)
    assert nothing["position"].shape == nothing["colour"].shape == (0, 3)


def test_a_surface_is_shown_with_its_faces(sphere_dataset, camera_ring):
    dataset = sphere_dataset(camera_ring(3, 16))
    corners = np.eye(3)
    shape = surface_shape(Surface(corners, corners, np.array([[0, 1, 2]]), 0.1), dataset)
    assert shape["faces"].dtype == np.int32 and np.array_equal(shape["position"], corners) and len(shape["colour"]) == 3


SIZES = [((1024, 512), (256, 128)), ((512, 1024), (128, 256)), ((100, 40), (100, 40)), ((4000, 3), (256, 1))]


@pytest.mark.parametrize(("size", "expected"), SIZES)
def test_previews_are_small_and_see_the_same(camera_ring, size, expected):
    (camera,) = camera_ring(1, 64)
    camera = replace(camera, width=size[0], height=size[1], fx=700.0, fy=700.0, cx=size[0] / 2, cy=size[1] / 2)
    small = preview_camera(camera)
    assert (small.width, small.height) == expected
    assert small.fx / small.width == pytest.approx(camera.fx / camera.width)


def test_albedo_is_shown_encoded_on_black(splat_sphere, camera_ring):
    splats = splat_sphere(3000, opacity=0.999)
    splats.material[:3] = torch.logit(torch.tensor([0.5, 0.2, 0.05]))[:, None]
    reconstruction = Reconstruction(splats, torch.ones(8, 16, 3), Bound((0.0, 0.0, 0.0), 1.5), np.eye(4))
    image = albedo_image(reconstruction, camera_ring(1, 64)[0])
    assert image.shape == (64, 64, 3)
    np.testing.assert_allclose(image[32, 32], [188, 124, 63], atol=2)  # sRGB of those
    assert image[0, 0].max() == 0
