# SPDX-License-Identifier: GPL-3.0-or-later
"""Deferred reflections and compositing against known results."""

import pytest
import torch
from irgspp.core.io.srgb import encode_srgb
from irgspp.core.rendering.deferred import background_radiance, composite, radiance, reflective_radiance, splat_radiance, surface_pixels
from irgspp.core.shading.environment_lookup import rotate
from irgspp.core.shading.split_sum import specular_light

LIGHT = torch.tensor([0.5, 1.0, 2.0])
COLOUR = torch.tensor([0.2, 0.3, 0.4])
SIZE = 6


def image(albedo, roughness, metallic, alpha=0.7, normal=(0.0, 0.0, 1.0)):
    """Rasterised sums of a plane, and rays that look straight down at it."""
    layers = torch.tensor([*COLOUR, *normal, *albedo, roughness, metallic, 3.0, 1.0])
    return (alpha * layers)[:, None, None].repeat(1, SIZE, SIZE), torch.tensor([0.0, 0.0, -2.0])[:, None, None].repeat(1, SIZE, SIZE)


def constant_light():
    return LIGHT.expand(16, 32, 3).contiguous()


def test_white_mirror_shows_the_light():
    shown = radiance(*image((1, 1, 1), 0.1, 1.0), constant_light())
    assert torch.allclose(shown, LIGHT[:, None, None].expand_as(shown), rtol=0.02)


def test_coloured_metal_tints_the_light_and_hides_the_body():
    shown = radiance(*image((0.9, 0.5, 0.2), 0.1, 1.0), constant_light())
    assert torch.allclose(shown[:, 0, 0], LIGHT * torch.tensor([0.9, 0.5, 0.2]), rtol=0.02)


def test_dielectric_adds_four_per_cent():
    shown = radiance(*image((1, 1, 1), 0.1, 0.0), constant_light())
    assert torch.allclose(shown[:, 0, 0], COLOUR + 0.04 * LIGHT, rtol=0.01)


def test_mirror_looks_the_right_way():
    light = torch.zeros(32, 64, 3)
    light[:16] = 1.0  # the upper half
    stack = specular_light(light)
    up, rays = image((1, 1, 1), 0.0, 1.0)
    down, _ = image((1, 1, 1), 0.0, 1.0, normal=(0.0, 0.0, -1.0))
    assert reflective_radiance(up, rays, stack).min() > 0.9
    assert reflective_radiance(down, -rays, stack).max() < 0.1


def test_reflections_and_background_turn_with_the_light():
    """A quarter turn of the light about +Z is a quarter turn of its map; no rotation changes no bit."""
    random = torch.Generator().manual_seed(0)
    light, quarter = torch.rand(16, 32, 3, generator=random) + 0.1, torch.tensor([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]])
    sums, rays = image((1, 1, 1), 0.1, 1.0, normal=(0.6, 0.0, 0.8))
    rolled = torch.from_numpy(rotate(light.numpy(), -90.0)).float()
    for shown in (radiance, lambda sums, rays, light, *turn: background_radiance(light, rays + 0.5, *turn)):
        turned = shown(sums, rays, light, quarter)
        assert torch.allclose(turned, shown(sums, rays, rolled), atol=1e-5)
        assert not torch.allclose(turned, shown(sums, rays, light), atol=0.01)
        assert torch.equal(shown(sums, rays, light, None), shown(sums, rays, light))


@pytest.mark.parametrize("alpha", [0.02, 0.5, 1.0])
def test_faint_pixels_show_their_own_colour(alpha):
    sums, rays = image((1, 1, 1), 0.1, 1.0, alpha=alpha)
    assert torch.allclose(splat_radiance(sums)[:, 0, 0], COLOUR, rtol=1e-5)
    shown = radiance(sums, rays, constant_light())[:, 0, 0]
    assert torch.allclose(shown, COLOUR if alpha < 0.05 else LIGHT, rtol=0.02)


def test_surface_pixels_are_means_of_the_covered():
    sums, rays = image((0.1, 0.2, 0.3), 0.4, 0.5, alpha=0.6)
    sums[:, 2, 3] = 0
    p = surface_pixels(sums, rays)
    assert p.index.tolist() == [i for i in range(SIZE * SIZE) if i != 2 * SIZE + 3]
    assert torch.allclose(p.albedo[0], torch.tensor([0.1, 0.2, 0.3])) and torch.allclose(p.colour[0], COLOUR)
    assert p.roughness[0].item() == pytest.approx(0.4) and p.metallic[0].item() == pytest.approx(0.5)
    assert p.view[0].tolist() == [0, 0, 1] and p.normal[0].tolist() == [0, 0, 1] and p.alpha[0].item() == pytest.approx(0.6)


def test_composite_on_black_and_on_a_background():
    straight = torch.rand(3, SIZE, SIZE, generator=torch.Generator().manual_seed(0))
    alpha = torch.linspace(0, 1, SIZE * SIZE).reshape(SIZE, SIZE)
    rays = torch.randn(3, SIZE, SIZE, generator=torch.Generator().manual_seed(1))
    assert torch.equal(composite(straight, alpha, rays, None), encode_srgb(straight) * alpha)
    expected = encode_srgb(straight * alpha + LIGHT[:, None, None] * (1 - alpha))
    assert torch.allclose(composite(straight, alpha, rays, constant_light()), expected, atol=1e-5)
