# SPDX-License-Identifier: GPL-3.0-or-later
"""Importance sampling of light maps, including poles, seam and single bright texels."""

import math

import pytest
import torch
from irgspp.core.shading.environment_lookup import lookup, solid_angles
from irgspp.core.shading.sampling import LightDistribution
from sampling_checks import COUNT, F64, LIGHT_MAPS, NORMAL, assert_follows, hot_texel, one_sample_each


def sphere_grid(height, width, fine):
    """Directions (H fine, W fine, 3) at the centres of the parts of texels, z and azimuth uniform inside each, and their solid angles."""
    edges = torch.cos(torch.arange(height + 1, dtype=F64) * (math.pi / height))
    share = (torch.arange(fine, dtype=F64) + 0.5) / fine
    z = (edges[:-1, None] + (edges[1:] - edges[:-1])[:, None] * share).reshape(-1, 1)
    phi = math.pi - (torch.arange(width * fine, dtype=F64) + 0.5) * (2 * math.pi / (width * fine))
    s = (1 - z * z).sqrt()
    angle = solid_angles(height, width, F64).repeat_interleave(fine) / fine**2
    return torch.stack([s * phi.cos(), s * phi.sin(), z.expand(-1, len(phi))], -1), angle[:, None].expand(-1, len(phi))


@pytest.mark.parametrize("name", LIGHT_MAPS)
def test_light_samples_follow_their_density(name):
    light = LIGHT_MAPS[name]
    height, width = light.shape[:2]
    distribution = LightDistribution(light.double())
    grid, angle = sphere_grid(height, width, 2)
    probability = distribution.density(grid) * angle
    assert probability.sum().item() == pytest.approx(1, abs=1e-9)
    assert probability.min() > 0

    direction, density = one_sample_each(NORMAL, NORMAL, 0.5, (0, 0, 1), LightDistribution(light))
    assert torch.allclose(direction.norm(dim=-1), torch.ones(COUNT, dtype=F64), atol=1e-6)
    agree = ((density - distribution.density(direction)).abs() < 1e-5 * density).double().mean()
    assert agree > 0.9999  # but where rounding takes a direction over an edge
    edges = torch.cos(torch.arange(height + 1, dtype=F64) * (math.pi / height))
    row = (torch.searchsorted(-edges, -direction[:, 2].contiguous()) - 1).clamp(0, height - 1)
    inside = ((edges[row] - direction[:, 2]) / (edges[row] - edges[row + 1]) * 2).long().clamp(0, 1)
    column = ((0.5 - torch.atan2(direction[:, 1], direction[:, 0]) / (2 * math.pi)) * 2 * width).long().clamp(0, 2 * width - 1)
    assert_follows((row * 2 + inside) * 2 * width + column, probability.reshape(-1))


@pytest.mark.parametrize("name", ["hot pole", "hot seam", "hot middle"])
def test_light_that_lookup_spreads_over_the_edge_is_likely_too(name):
    """Radiance over density, a sample's weight, is nowhere much greater than in the middle of the hot texel."""
    light = LIGHT_MAPS[name].double()
    grid = sphere_grid(16, 32, 7)[0].reshape(-1, 3)
    weight = lookup(light, grid)[:, 1] / LightDistribution(light).density(grid)
    middle = weight[lookup(light, grid)[:, 1].argmax()]
    assert weight.max() < 10 * middle


def test_black_texels_stay_alive_and_black_maps_are_uniform():
    light = hot_texel(7, 12)
    grid, _ = sphere_grid(16, 32, 1)
    density = LightDistribution(light).density(grid.float())
    assert density.min() > 0.5e-3 / (4 * math.pi)
    uniform = LightDistribution(torch.zeros(4, 8, 3)).density(grid.float())
    assert torch.allclose(uniform, torch.full_like(uniform, 1 / (4 * math.pi)))


@pytest.mark.parametrize("bad", [torch.zeros(4, 8), torch.zeros(4, 8, 4), torch.zeros(0, 8, 3), torch.full((4, 8, 3), math.nan)])
def test_what_is_no_light_map_is_refused(bad):
    with pytest.raises(ValueError, match="light map"):
        LightDistribution(bad)
