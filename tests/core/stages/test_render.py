# SPDX-License-Identifier: GPL-3.0-or-later
"""A sphere of splats seen by a camera against the sphere itself."""

import numpy as np
import pytest
import torch
from irgspp.core.datasets.dataset import Bound
from irgspp.core.scene.reconstruction import Reconstruction
from irgspp.core.stages.render import reduced, render_view, shade_view

ALBEDO = (0.6, 0.4, 0.2)


@pytest.fixture(scope="module")
def reconstruction(splat_sphere):
    g = splat_sphere(6000, opacity=0.99)
    g.material = torch.logit(torch.tensor([*ALBEDO, 0.8, 1e-4]))[:, None].repeat(1, g.count)
    return Reconstruction(g, torch.full((16, 32, 3), 0.9), Bound((0, 0, 0), 1.5), np.eye(4))


@pytest.fixture(scope="module")
def camera(camera_ring):
    return camera_ring(5, size=128)[3]


@pytest.fixture(scope="module")
def analytic(camera):
    """Planar depth, normal and distance of each ray to the silhouette, in pixels (negative inside)."""
    rays = camera.rays().astype(np.float64)
    a, b, c = (rays**2).sum(-1), rays @ camera.centre, camera.centre @ camera.centre - 1
    root = b * b - a * c
    depth = (-b - np.sqrt(np.maximum(root, 0))) / a
    angle = np.arccos(np.clip(-b / np.sqrt(a * (c + 1)), -1, 1)) - np.arcsin(1 / np.sqrt(c + 1))
    return depth, camera.centre + depth[..., None] * rays, angle * camera.fx


def test_layers_are_those_of_the_sphere(reconstruction, camera, analytic):
    depth, normal, edge = analytic
    seen = render_view(reconstruction, camera)
    inside, outside = edge < -2, edge > 2
    assert inside.sum() > 500 and outside.sum() > 500
    assert seen.alpha[inside].min() > 0.99 and seen.alpha[outside].max() < 0.01
    # A small splat's centre stands for all of it, and the far side shines through a little.
    assert np.abs(seen.depth - depth)[inside].max() < 0.06
    assert np.abs(seen.depth - depth)[inside].mean() < 0.005
    assert (seen.normal * normal).sum(-1)[inside].min() > 0.99
    assert np.allclose(seen.albedo[inside], ALBEDO, atol=1e-4)
    assert np.allclose(seen.roughness[inside], 0.8, atol=1e-4) and np.allclose(seen.metallic[inside], 0, atol=1e-3)
    assert np.allclose(seen.radiance[inside], 0.5, atol=1e-4)
    empty = seen.alpha == 0
    assert empty.any() and not seen.depth[empty].any() and not seen.normal[empty].any() and not seen.radiance[empty].any()


def test_constant_light_gives_about_the_albedo(reconstruction, camera, analytic):
    inside = analytic[2] < -2
    rgba = shade_view(reconstruction, camera, np.ones((16, 32, 3), np.float32))
    assert rgba.dtype == np.float32 and rgba.shape == (camera.height, camera.width, 4)
    light = rgba[inside][:, :3] / rgba[inside][:, 3:]
    assert (light > np.array(ALBEDO)).all()  # the body, and
    assert (light < np.array(ALBEDO) + 0.3).all() and np.median(light - np.array(ALBEDO)) < 0.06  # what a dielectric reflects
    assert rgba[analytic[2] > 2].max() < 0.01


def test_shading_is_linear_in_the_light_and_falls_back_on_the_recovered_one(reconstruction, camera):
    one, three = (shade_view(reconstruction, camera, np.full((16, 32, 3), x, np.float32)) for x in (0.9, 2.7))
    assert np.allclose(three[..., :3], 3 * one[..., :3], atol=1e-5)
    assert np.allclose(shade_view(reconstruction, camera, None), one, atol=1e-6)


def test_light_from_one_side_shines_on_that_side(reconstruction, camera, analytic):
    _, normal, edge = analytic
    light = np.zeros((32, 64, 3), np.float32)
    light[:8] = 1  # straight above
    rgba = shade_view(reconstruction, camera, light)
    inside = edge < -2
    top, bottom = inside & (normal[..., 2] > 0.5), inside & (normal[..., 2] < -0.9)
    assert rgba[top][:, 0].min() > 5 * max(rgba[bottom][:, 0].max() if bottom.any() else 0, 1e-3)


def test_glossy_reconstruction_shows_reflections(reconstruction, camera, analytic):
    inside = analytic[2] < -2
    glossy = Reconstruction(reconstruction.gaussians, reconstruction.environment, reconstruction.bound, np.eye(4), glossy=True)
    added = (render_view(glossy, camera).radiance - render_view(reconstruction, camera).radiance)[inside]
    assert added.min() > 0.01 and np.median(added) < 0.06


@pytest.mark.parametrize("height", [16, 64, 256])
def test_reduced_light_keeps_its_mean(height):
    light = np.random.default_rng(0).random((height, 2 * height, 3)).astype(np.float32)
    small = reduced(light)
    assert small.shape == (min(height, 64), 2 * min(height, 64), 3)
    assert np.allclose(small.mean((0, 1)), light.mean((0, 1)), atol=1e-5)
