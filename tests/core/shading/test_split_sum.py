# SPDX-License-Identifier: GPL-3.0-or-later
"""Prefiltered light and the BRDF table against direct integration."""

import math

import pytest
import torch
from irgspp.core.shading import brdf, split_sum
from irgspp.core.shading import environment_lookup as lightmap


def smooth_light(height=32, width=64):
    d = lightmap.texel_directions(height, width)
    return torch.stack([1 + d[..., 0] * d[..., 1], 1.5 + d[..., 2], 1 + 0.5 * d[..., 0]], -1)


def test_constant_light_stays_constant():
    light = torch.full((16, 32, 3), 0.7)
    assert split_sum.diffuse_light(light).sub(0.7).abs().max() < 1e-5
    assert split_sum.specular_light(light).sub(0.7).abs().max() < 1e-5


def test_diffuse_light_is_the_cosine_integral():
    light = smooth_light()
    direction = lightmap.texel_directions(32, 64)
    normal = torch.nn.functional.normalize(torch.tensor([0.3, -0.5, 0.6]), dim=0)
    weight = (direction @ normal).clamp_min(0) * lightmap.solid_angles(32, 64)[:, None]
    expected = (light * weight[..., None]).sum((0, 1)) / math.pi
    found = lightmap.lookup(split_sum.diffuse_light(light), normal[None])[0]
    assert found.tolist() == pytest.approx(expected.tolist(), rel=5e-3)


@pytest.mark.parametrize("degrees", [90.0, -37.5])
def test_lookup_and_rotation_follow_blender_axes(degrees):
    d = lightmap.texel_directions(64, 128)
    light = (d + 1) / 2  # colour tells the direction
    probe = torch.nn.functional.normalize(torch.randn(200, 3, generator=torch.Generator().manual_seed(0)), dim=-1)
    assert lightmap.lookup(light, probe).sub((probe + 1) / 2).abs().max() < 0.01
    angle = math.radians(degrees)
    probe = torch.tensor([[math.cos(angle), math.sin(angle), 0.0]])
    turned = lightmap.lookup(torch.from_numpy(lightmap.rotate(light.numpy(), degrees)).float(), probe)[0]
    assert turned.tolist() == pytest.approx([1.0, 0.5, 0.5], abs=0.02)


def test_axes_of_the_map():
    u, v = lightmap.direction_to_uv(torch.tensor([[1.0, 0, 0], [0, 1.0, 0], [0, -1.0, 0], [0, 0, 1.0]]))
    assert u[:3].tolist() == pytest.approx([0.5, 0.25, 0.75])
    assert v.tolist() == pytest.approx([0.5, 0.5, 0.5, 0.0], abs=1e-3)


@pytest.mark.parametrize(("roughness", "n_v"), [(0.2, 0.9), (0.5, 0.5), (0.8, 0.3), (1.0, 0.8)])
def test_table_is_the_integral_of_the_brdf(roughness, n_v):
    steps = 600
    theta = (torch.arange(steps, dtype=torch.float64) + 0.5) * (math.pi / 2 / steps)
    phi = (torch.arange(steps, dtype=torch.float64) + 0.5) * (2 * math.pi / steps)
    theta, phi = torch.meshgrid(theta, phi, indexing="ij")
    light = torch.stack([theta.sin() * phi.cos(), theta.sin() * phi.sin(), theta.cos()], -1)
    view = torch.tensor([math.sqrt(1 - n_v**2), 0, n_v], dtype=torch.float64)
    half = torch.nn.functional.normalize(light + view, dim=-1)
    alpha = brdf.ggx_alpha(torch.tensor(roughness, dtype=torch.float64))
    f0 = torch.tensor(0.3, dtype=torch.float64)
    f = brdf.ggx_distribution(half[..., 2], alpha) * brdf.smith_visibility(light[..., 2], torch.tensor(n_v).double(), alpha)
    f = f * (f0 + (1 - f0) * brdf.fresnel_weight(half @ view))
    expected = (f * light[..., 2] * theta.sin()).sum() * (math.pi / 2 / steps) * (2 * math.pi / steps)
    found = split_sum.specular_albedo(torch.tensor([n_v]), torch.tensor([roughness]), torch.full((1, 3), 0.3))
    assert found[0, 0].item() == pytest.approx(expected.item(), rel=0.02)


@pytest.mark.parametrize(
    ("roughness", "n_v", "cycles"),
    [(0.2, 0.8, 0.0441), (0.2, 0.5, 0.0894), (0.5, 0.8, 0.0415), (0.5, 0.5, 0.0670), (0.8, 0.8, 0.0258), (0.8, 0.5, 0.0362)],
)
def test_gloss_is_that_of_cycles(roughness, n_v, cycles):
    """Radiance of a black sphere under a white sky in Blender 4.5: Principled BSDF, GGX, 1024 samples, mean over a ring of pixels."""
    found = split_sum.specular_albedo(torch.tensor([n_v]), torch.tensor([roughness]), torch.full((1, 3), 0.04))
    assert found[0, 0].item() == pytest.approx(cycles, rel=0.01)


@pytest.mark.parametrize(("roughness", "n_v"), [(0.2, 0.9), (0.5, 0.5), (1.0, 0.8)])
def test_table_of_irgs_is_the_integral_of_its_lobe(roughness, n_v):
    steps, f64 = 600, torch.float64
    theta = (torch.arange(steps, dtype=f64) + 0.5) * (math.pi / 2 / steps)
    phi = (torch.arange(steps, dtype=f64) + 0.5) * (2 * math.pi / steps)
    theta, phi = torch.meshgrid(theta, phi, indexing="ij")
    light = torch.stack([theta.sin() * phi.cos(), theta.sin() * phi.sin(), theta.cos()], -1).view(1, -1, 3)
    view, up = torch.tensor([[math.sqrt(1 - n_v**2), 0, n_v]], dtype=f64), torch.tensor([[0, 0, 1]], dtype=f64)
    n_l, value, power = brdf.irgs_lobe(view, up, torch.tensor([roughness], dtype=f64), light)
    expected = ((0.04 + 0.96 * power) * value * n_l * theta.sin().flatten()).sum() * (math.pi / 2 / steps) * (2 * math.pi / steps)
    found = split_sum.specular_albedo(torch.tensor([n_v]), torch.tensor([roughness]), torch.full((1, 3), 0.04), "irgs")
    assert found[0, 0].item() == pytest.approx(expected.item(), rel=0.02)


def test_gradients_reach_light_normal_and_materials():
    light = smooth_light(16, 32).requires_grad_()
    normal = torch.nn.functional.normalize(torch.randn(20, 3, generator=torch.Generator().manual_seed(1)), dim=-1).requires_grad_()
    view = torch.nn.functional.normalize(normal.detach() + 0.3, dim=-1)
    materials = [torch.rand(20, 3).requires_grad_(), torch.rand(20).requires_grad_(), torch.rand(20).requires_grad_()]
    split_sum.shade(view, normal, *materials, split_sum.diffuse_light(light), split_sum.specular_light(light)).square().sum().backward()
    for tensor in (light, normal, *materials):
        assert torch.isfinite(tensor.grad).all() and tensor.grad.abs().sum() > 0
