# SPDX-License-Identifier: GPL-3.0-or-later
"""Preview images: small, correct, and without effect on the optimisation."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from irgspp.core.progress.protocol import Silent
from irgspp.core.scene.dataset import Bound
from irgspp.core.scene.reconstruction import Reconstruction
from irgspp.core.settings.overrides import with_overrides
from irgspp.core.settings.schema import preset
from irgspp.core.stages.common.preview import albedo_image, preview_camera
from irgspp.core.stages.first.train import train

SMALL = ("first.iterations=12", "first.gaussians=400", "first.light_height=16", "materials=low-gloss")


class Looker(Silent):
    """Progress that draws every image that is offered."""

    def __init__(self):
        self.images = []

    def image(self, draw):
        self.images.append(draw())


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
