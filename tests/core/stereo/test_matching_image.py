# SPDX-License-Identifier: GPL-3.0-or-later
"""Half resolution shows the same places, without the background; sources are packed one after another."""

from dataclasses import replace

import numpy as np
from irgspp.core.stereo.matching_image import matching_image, pack_sources


def test_half_resolution_sees_the_same_places(camera_arc, sphere):
    image = matching_image(replace(sphere.views[0], colour=sphere.views[0].colour[:55, :61], alpha=None))
    image = replace(image, camera=replace(image.camera, width=61, height=55))
    half = image.halved()
    assert half.grey.shape == (27, 30) == (half.camera.height, half.camera.width) and half.inside.all()
    assert np.allclose(half.grey[3, 5], image.grey[6:8, 10:12].mean())
    points = np.random.default_rng(0).normal(0, 0.3, (20, 3))
    assert np.allclose(2 * half.camera.project(points)[0], image.camera.project(points)[0])


def test_background_does_not_blend_into_half_resolution(sphere):
    view = sphere.views[0]
    image = matching_image(view)
    other = matching_image(replace(view, colour=np.where(view.alpha[..., None] < 0.5, np.float32(1), view.colour)))
    assert (image.grey != other.grey).any()
    one, two = image.halved(), other.halved()
    assert np.array_equal(one.inside, two.inside) and np.array_equal(one.grey[one.inside], two.grey[two.inside])


def test_sources_are_packed_one_after_another(sphere):
    images = [matching_image(view) for view in sphere.views[:3]]
    images[1] = images[1].halved()
    packed = pack_sources(images[0], images[1:], [image.grey + 1 for image in images[1:]])
    assert packed.layout.tolist() == [[0, 32, 32], [32 * 32, 64, 64]]
    assert np.array_equal(packed.grey[1024:].reshape(64, 64), images[2].grey) and np.array_equal(packed.depth, packed.grey + 1)
    point = np.array([0.2, 0.1, -0.1])
    x = images[0].camera.world_to_cv[:3] @ [*point, 1]
    moved = packed.pose[1][:9].reshape(3, 3) @ x + packed.pose[1][9:12]
    fx, fy, cx, cy = packed.pose[1][12:]
    pixel, depth = images[2].camera.project(point[None])
    assert np.allclose([moved[0] / moved[2] * fx + cx, moved[1] / moved[2] * fy + cy], pixel[0], atol=1e-3)
    assert np.isclose(moved[2], depth[0], atol=1e-5)
