# SPDX-License-Identifier: GPL-3.0-or-later
"""Radiance transfer against closed forms and Monte Carlo estimates of the same light."""

import math

import numpy as np
import pytest
import torch
from irgspp.core.rendering.secondary_rays import SecondaryTracer
from irgspp.core.scene.dataset import Bound
from irgspp.core.scene.reconstruction import Reconstruction
from irgspp.core.shading.environment_lookup import direction_to_uv
from irgspp.core.shading.rendering_equation import reflect_light
from irgspp.core.shading.sampling import LightDistribution, draw
from irgspp.core.stages.second.solver import transfer_tracing
from irgspp.core.stages.second.solver.light_texels import LightTexels
from irgspp.core.stages.second.solver.multi_view_samples import MultiViewSamples
from irgspp.core.stages.second.solver.transfer_tracing import trace_radiance_transfer

HEIGHT = 8
RADIANCE = np.array([0.6, 0.3, 0.1])  # of the sphere


@pytest.fixture(scope="module")
def tracer(splat_sphere):
    """Tracer of a unit sphere that emits light."""
    sphere = splat_sphere(6000, np.tile(RADIANCE, (6000, 1)), 0.999)
    return SecondaryTracer(Reconstruction(sphere, torch.ones(8, 16, 3), Bound((0, 0, 0), 1.0), np.eye(4)))


def points(*rows):
    """Return positions and unit normals."""
    position, normal = torch.tensor(rows, dtype=torch.float32).split(3, 1)
    return position.contiguous(), torch.nn.functional.normalize(normal, dim=1)


def test_nothing_in_the_way_and_white_light_make_irradiance_one(tracer):
    position, normal = points((0, 0, 5, 0, 0, 1), (5, 0, 0, 3, 1, -2), (0, -4, 4, 0, -1, 1))
    transfer = trace_radiance_transfer(position, normal, tracer, LightTexels.uniform(HEIGHT), side=2, seed=0, indirect=True)
    np.testing.assert_allclose(transfer.irradiance.sum(1), 1, atol=5e-3)
    assert (transfer.indirect == 0).all()
    assert (transfer.traced.visibility == (normal.numpy() @ transfer.traced.direction > 0)).all()


def test_each_texel_brings_what_its_cosine_lets_it(tracer):
    position, normal = points((0, 0, 5, 0, 0, 1))
    transfer = trace_radiance_transfer(position, normal, tracer, LightTexels.uniform(HEIGHT), side=4, seed=0, indirect=True)
    edge = np.cos(np.arange(HEIGHT + 1) * math.pi / HEIGHT)
    row = np.maximum(edge[:-1], 0) ** 2 - np.maximum(edge[1:], 0) ** 2  # exactly: integral of 2 cos over the row
    actual = transfer.irradiance.view(HEIGHT, -1)
    np.testing.assert_allclose(actual, np.repeat(row[:, None] / (2 * HEIGHT), 2 * HEIGHT, 1), rtol=0.1, atol=1e-9)
    np.testing.assert_allclose(actual.sum(1), row, rtol=0.02, atol=1e-9)


@pytest.mark.parametrize("distance", [1.5, 2.0, 3.0])
def test_a_sphere_ahead_takes_light_and_gives_its_own_by_its_form_factor(tracer, distance):
    position, normal = points((0, 0, -distance, 0, 0, 1))
    transfer = trace_radiance_transfer(position, normal, tracer, LightTexels.uniform(16), side=3, seed=0, indirect=True)
    form = 1 / (distance - tracer.offset) ** 2  # of a unit sphere and a patch that faces it
    assert 1 - float(transfer.irradiance.sum()) == pytest.approx(form, rel=0.04)
    np.testing.assert_allclose(transfer.indirect[0], form * RADIANCE, rtol=0.04)


def test_own_light_can_be_left_out_and_shadows_stay(tracer):
    position, normal = points((0, 0, -1.5, 0, 0, 1))
    both = [
        trace_radiance_transfer(position, normal, tracer, LightTexels.uniform(HEIGHT), side=2, seed=0, indirect=indirect)
        for indirect in (True, False)
    ]
    assert torch.equal(both[0].irradiance, both[1].irradiance)
    assert (both[0].indirect > 0.01).all() and (both[1].indirect == 0).all() and (both[1].traced.indirect_radiance == 0).all()


def test_points_traced_a_few_at_a_time_are_the_same(tracer, monkeypatch):
    position, normal = points(*np.random.default_rng(0).normal(size=(9, 6)).tolist())
    whole = trace_radiance_transfer(position, normal, tracer, LightTexels.uniform(4), side=2, seed=3, indirect=True)
    monkeypatch.setattr(transfer_tracing, "RAY_BATCH", 128)
    parts = trace_radiance_transfer(position, normal, tracer, LightTexels.uniform(4), side=2, seed=3, indirect=True)
    assert torch.equal(whole.irradiance, parts.irradiance) and torch.equal(whole.indirect, parts.indirect)
    assert all(np.array_equal(a, b) for a, b in zip(whole.traced, parts.traced, strict=True))


def test_views_of_points_agree_with_monte_carlo(tracer):
    """Shadow, the sphere's own light and lobes of three widths together: both estimate the same integral."""
    position, normal = points((0, 0, -1.6, 0.6, 0, 1), (1.5, 0, 0, -1, 0.5, 0.5), (0, 1.4, 0.4, 0.3, -1, 0.2))
    roughness, metallic = torch.tensor([0.3, 0.5, 0.8]), torch.tensor([0.0, 0.5, 1.0])
    albedo = torch.tensor([[0.8, 0.4, 0.2]]).expand(3, 3)
    view = torch.nn.functional.normalize(normal + 0.7 * torch.tensor([[0.0, 1, 0], [0, 0, 1], [1, 0, 0]]), dim=1)
    light = torch.rand(2 * HEIGHT**2, 3, generator=torch.Generator().manual_seed(0)) + 0.1
    transfer = trace_radiance_transfer(position, normal, tracer, LightTexels.uniform(HEIGHT), side=16, seed=0, indirect=True)
    black = torch.zeros(3, 3)
    seen = MultiViewSamples(position, normal, torch.arange(3), view, black, black.bool())
    f0_term, fresnel_term, f0_indirect, fresnel_indirect = transfer.rows(seen, roughness)
    f0 = 0.04 * (1 - metallic[:, None]) + metallic[:, None] * albedo
    specular = f0 * (f0_term @ light + f0_indirect) + fresnel_term @ light + fresnel_indirect
    diffuse = (1 - metallic[:, None]) * albedo * (transfer.irradiance @ light + transfer.indirect)
    expected = monte_carlo(tracer, position, view, normal, albedo, roughness, metallic, light)
    np.testing.assert_allclose(diffuse, expected[0], rtol=0.01, atol=1e-6)
    np.testing.assert_allclose(specular, expected[1], rtol=0.01)


def monte_carlo(tracer, position, view, normal, albedo, roughness, metallic, light):
    """Estimate diffuse and specular radiance (3, 3) by 64 x 1024 samples each under a light of constant texels."""
    many = [t.repeat_interleave(64, 0).contiguous() for t in (position, view, normal, albedo, roughness, metallic)]
    map_of_light = light.view(HEIGHT, -1, 3)
    samples = draw(many[1], many[2], many[4], (512, 384, 128), LightDistribution(map_of_light), torch.Generator().manual_seed(1))
    direction = samples.direction.view(-1, 3)
    free, own = tracer.look(tracer.above(many[0], many[2]).repeat_interleave(1024, 0), direction)
    u, v = direction_to_uv(direction)
    texel = (v * HEIGHT).long().clamp_max(HEIGHT - 1) * 2 * HEIGHT + (u * 2 * HEIGHT).long().clamp_max(2 * HEIGHT - 1)
    incoming = (light[texel] * free[:, None] + own).view_as(samples.direction)
    parts = reflect_light(many[1], many[2], *many[3:], samples, incoming, conserving=False)
    return [part.view(3, 64, 3).mean(1) for part in parts]


def test_sums_for_many_roughness_values_agree_with_rows(tracer):
    position, normal = points((0, 0, -1.6, 0.6, 0, 1), (1.5, 0, 0, -1, 0.5, 0.5))
    transfer = trace_radiance_transfer(position, normal, tracer, LightTexels.uniform(HEIGHT), side=2, seed=0, indirect=True)
    black = torch.zeros(2, 3)
    seen = MultiViewSamples(position, normal, torch.arange(2), normal, black, black.bool())
    light, knots = torch.rand(2 * HEIGHT**2, 3), torch.tensor([0.1, 0.4, 0.9])
    sums = transfer.sums(seen, knots, light)
    for j, knot in enumerate(knots):
        rows = transfer.rows(seen, knot.expand(2))
        for k in range(2):
            np.testing.assert_allclose(sums[k][:, j], rows[k] @ light + rows[2 + k], rtol=1e-4, atol=1e-6)
