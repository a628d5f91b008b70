# SPDX-License-Identifier: GPL-3.0-or-later
"""G-buffer of a sphere of surfels against the analytic sphere."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from irgspp.core.rendering import gbuffer
from irgspp.core.rendering.gbuffer import downsampled_light, rasterize_view, render_gbuffer
from irgspp.core.scene.dataset import Bound
from irgspp.core.scene.reconstruction import Reconstruction, Reflections

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
    """Planar depth, normal, and distance of each ray to the silhouette in pixels (negative inside)."""
    rays = camera.rays().astype(np.float64)
    a, b, c = (rays**2).sum(-1), rays @ camera.centre, camera.centre @ camera.centre - 1
    root = b * b - a * c
    depth = (-b - np.sqrt(np.maximum(root, 0))) / a
    angle = np.arccos(np.clip(-b / np.sqrt(a * (c + 1)), -1, 1)) - np.arcsin(1 / np.sqrt(c + 1))
    return depth, camera.centre + depth[..., None] * rays, angle * camera.fx


def test_layers_are_those_of_the_sphere(reconstruction, camera, analytic):
    depth, normal, edge = analytic
    seen = render_gbuffer(reconstruction, camera)
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


@pytest.mark.parametrize("shaded", [True, False])
def test_confidence_is_a_layer_and_changes_no_other(reconstruction, camera, analytic, shaded):
    """Of a glossy reconstruction whose reflections have materials of their own, which are further channels."""
    g = reconstruction.gaussians
    mirrored = Reflections(torch.full((5, g.count), 0.5), torch.rand(8, 16, 3, generator=torch.Generator().manual_seed(0)))
    plain = replace(reconstruction, has_split_sum=True, reflections=mirrored)
    known = replace(plain, confidence=torch.tensor([0.2, 0.5, 0.9])[:, None].repeat(1, g.count))
    with_it, without = render_gbuffer(known, camera, shaded=shaded), render_gbuffer(plain, camera, shaded=shaded)
    for name in ("alpha", "depth", "normal", "radiance", "albedo", "roughness", "metallic"):
        np.testing.assert_allclose(getattr(with_it, name), getattr(without, name), atol=1e-6, err_msg=name)
    assert without.confidence is None
    assert np.allclose(with_it.confidence[analytic[2] < -2], [0.2, 0.5, 0.9], atol=1e-5)
    assert not with_it.confidence[with_it.alpha == 0].any()


def test_unshaded_layers_are_the_same_without_radiance(reconstruction, camera):
    glossy = Reconstruction(reconstruction.gaussians, reconstruction.environment, reconstruction.bound, np.eye(4), has_split_sum=True)
    shaded, plain = render_gbuffer(glossy, camera), render_gbuffer(glossy, camera, shaded=False)
    for name in ("alpha", "depth", "normal", "albedo", "roughness", "metallic"):
        np.testing.assert_array_equal(getattr(plain, name), getattr(shaded, name), strict=True)
    assert shaded.radiance.any() and not plain.radiance.any() and plain.radiance.shape == shaded.radiance.shape


def test_pixel_is_the_mean_over_its_subpixels(reconstruction, camera):
    fine = rasterize_view(reconstruction, camera.resized(256, 256), subpixels=1)[0]
    assert torch.allclose(
        rasterize_view(reconstruction, camera, subpixels=2)[0], fine.unflatten(2, (128, 2)).unflatten(1, (128, 2)).mean((2, 4)), atol=1e-5
    )


def test_bands_of_rows_make_the_same_image(reconstruction, camera, monkeypatch):
    whole = rasterize_view(reconstruction, camera)[0]
    monkeypatch.setattr(gbuffer, "BAND", 4 * 128 * 10)  # 12 bands of 10 rows and one of 8
    assert torch.allclose(rasterize_view(reconstruction, camera)[0], whole, atol=1e-5)


def test_glossy_reconstruction_shows_reflections(reconstruction, camera, analytic):
    inside = analytic[2] < -2
    glossy = Reconstruction(reconstruction.gaussians, reconstruction.environment, reconstruction.bound, np.eye(4), has_split_sum=True)
    added = (render_gbuffer(glossy, camera).radiance - render_gbuffer(reconstruction, camera).radiance)[inside]
    assert added.min() > 0.01 and np.median(added) < 0.06


def test_radiance_stays_when_materials_and_light_are_new(reconstruction, camera):
    """Replacing materials and light changes the material layers alone, glossy or not."""
    g = reconstruction.gaussians
    new = torch.logit(torch.tensor([0.1, 0.8, 0.3, 0.2, 0.9]))[:, None].repeat(1, g.count)
    for glossy in (False, True):
        before = Reconstruction(g, reconstruction.environment, reconstruction.bound, np.eye(4), glossy)
        after = before.relabelled(new, torch.rand(8, 16, 3)).relabelled(new, torch.rand(8, 16, 3))
        old, seen = render_gbuffer(before, camera), render_gbuffer(after, camera)
        for name in ("radiance", "alpha", "depth", "normal"):
            assert np.array_equal(getattr(seen, name), getattr(old, name)), name
        inside = seen.alpha > 0.99
        assert np.allclose(seen.albedo[inside], [0.1, 0.8, 0.3], atol=1e-4)
        assert np.allclose(seen.roughness[inside], 0.2, atol=1e-4) and np.allclose(seen.metallic[inside], 0.9, atol=1e-4)


@pytest.mark.parametrize("height", [16, 64, 256])
def test_downsampled_light_keeps_its_mean(height):
    light = np.random.default_rng(0).random((height, 2 * height, 3)).astype(np.float32)
    small = downsampled_light(light)
    assert small.shape == (min(height, 64), 2 * min(height, 64), 3)
    assert np.allclose(small.mean((0, 1)), light.mean((0, 1)), atol=1e-5)
