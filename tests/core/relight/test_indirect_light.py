# SPDX-License-Identifier: GPL-3.0-or-later
"""The gathering kernel against its reference in PyTorch operations, and against the estimator of the rendering equation."""

import numpy as np
import pytest
import torch
from gather_reference import gather_reference
from irgspp.core.relight.direct_light import add_light_samples
from irgspp.core.relight.indirect_light import SecondaryRays, SecondaryScene, ShadingPoints, gather, trace_samples
from irgspp.core.relight.prepared_light import prepare_light
from irgspp.core.relight.sample_counts import SampleCounts
from irgspp.core.relight.visibility_cache import VisibilityCache
from irgspp.core.shading.brdf import ggx_alpha, irgs_lobe, specular_lobe
from irgspp.core.shading.environment_lookup import lookup, rotate
from irgspp.core.shading.procedural_lights import studio_light
from irgspp.core.shading.rendering_equation import reflect_light
from irgspp.core.shading.sampling import Samples, draw

pytestmark = pytest.mark.usefixtures("engine")
COUNTS = SampleCounts(9, 6, 5)
SCALE = torch.tensor([1.0, 0.8, 0.6])


@pytest.fixture
def light():
    """A light that is brighter on one side, of another size than its prefiltered maps."""
    return prepare_light(studio_light(40, 80) * np.linspace(0.5, 1.5, 80, dtype=np.float32)[None, :, None])


def points_of(surface, brdf="principled") -> tuple[ShadingPoints, torch.Tensor]:
    """A view's points and the shifts of their samples."""
    points = ShadingPoints.from_roughness(surface.origin, surface.view, surface.normal, surface.roughness, brdf)
    return points, torch.rand(len(surface.index), 2, generator=torch.Generator().manual_seed(0))


def drawn(surface, counts, light, **how) -> Samples:
    samples = draw(surface.view, surface.normal, surface.roughness, counts, light.distribution, points_of(surface)[1], **how)
    return Samples(samples.direction, samples.density * sum(counts))


def traced(one, surface, samples, scale=SCALE, transfer=None, brdf="principled") -> SecondaryRays:
    return trace_samples(SecondaryScene(one.query, scale, True, transfer, brdf=brdf), points_of(surface, brdf)[0], samples)


@pytest.mark.parametrize("brdf", ["principled", "irgs"])
@pytest.mark.parametrize("roughness", [0.03, 0.2, 0.7])
def test_terms_of_rays_are_the_brdf_in_double(relighter, camera, light, brdf, roughness):
    one = relighter("mesh", (0.6, 0.4, 0.2, roughness, 0.0))
    surface = one.surface(camera)
    samples = drawn(surface, COUNTS, light)
    terms = traced(one, surface, samples, brdf=brdf).terms[..., 2:5].double()
    points = points_of(surface, brdf)[0]
    at = (points.view.double(), points.normal.double())
    sharp = surface.roughness.double()
    if brdf == "irgs":
        n_l, value, power = irgs_lobe(*at, sharp, samples.direction.double())
    else:
        n_l, value, power = specular_lobe(*at, ggx_alpha(sharp), samples.direction.double())
    expected = torch.stack([n_l, value * (1 - power) * n_l, value * power * n_l], -1).masked_fill((n_l <= 0)[..., None], 0)
    error = (terms - expected).abs() / expected.abs().clamp_min(1e-3 * expected.abs().amax((0, 1)))
    assert error.quantile(0.999) < 5e-3 and error.mean() < 2e-4 and (expected[..., 1] > 0).any()


@pytest.mark.parametrize("roughness", [0.03, 0.4])
def test_light_samples_of_irgs_and_the_others_come_to_what_reflect_light_estimates(relighter, camera, light, roughness):
    one = relighter("mesh", (0.6, 0.4, 0.2, roughness, 0.0), ((np.zeros(3), 1.0),))
    surface = one.surface(camera)
    many = SampleCounts(*(8 * n for n in COUNTS))
    points, shift = points_of(surface, "irgs")
    sums = gather(traced(one, surface, drawn(surface, many._replace(light=0), light), None, brdf="irgs"), light, many.light)
    add_light_samples(sums, points, shift, many, light, VisibilityCache.unknown(len(shift)), one.query)
    samples = draw(surface.view, surface.normal, surface.roughness, many, light.distribution, shift)
    incoming, white = lookup(light.radiance, samples.direction.view(-1, 3)).view_as(samples.direction), torch.ones(len(shift), 3)
    diffuse, specular = reflect_light(
        surface.view, surface.normal, white, surface.roughness, torch.zeros(len(shift)), samples, incoming, brdf="irgs"
    )
    irradiance, f0_term, fresnel_term, _ = sums.sum(1).view(-1, 4, 3).unbind(1)
    torch.testing.assert_close((irradiance / torch.pi).mean(0), diffuse.mean(0), rtol=0.02, atol=0)
    torch.testing.assert_close((0.04 * f0_term + fresnel_term).mean(0), specular.mean(0), rtol=0.03, atol=0)


@pytest.mark.parametrize("backend", ["mesh", "gaussian"])
@pytest.mark.parametrize("material", [(0.6, 0.4, 0.2, 0.7, 0.0), (0.9, 0.7, 0.3, 0.2, 1.0)])
@pytest.mark.parametrize(("scale", "light_map_samples", "by_vertices"), [(SCALE, 0, False), (SCALE, 5, True), (None, 5, False)])
def test_gather_equals_its_reference(relighter, camera, light, backend, material, scale, light_map_samples, by_vertices):
    one = relighter(backend, material)
    surface = one.surface(camera)
    transfer = relighter("mesh", material).mesh.transfer if by_vertices else None
    rays = traced(one, surface, drawn(surface, COUNTS._replace(light=0) if light_map_samples else COUNTS, light), scale, transfer)
    assert 0 < len(rays.hits.opacity) < rays.row.numel() and rays.size > 20 * rays.row.numel()
    for seen in (light, light.turned(77)):
        vertex_light = transfer.light(seen, scale) if transfer else None
        found, expected = (function(rays, seen, light_map_samples, vertex_light) for function in (gather, gather_reference))
        scaled = (found - expected).abs() / expected.abs().mean(0)
        assert scaled.quantile(0.999) < 2e-3 and scaled.mean() < 1e-4


def test_parts_of_the_mixture_come_to_the_whole(relighter, camera, light):
    """Light-independent and light-map samples add up to all samples at once and, without occlusion, to what `reflect_light` estimates."""
    one = relighter("mesh", balls=((np.zeros(3), 1.0),))
    surface = one.surface(camera)
    whole = drawn(surface, COUNTS, light)
    at_once = gather(traced(one, surface, whole, None), light, 0).sum(1)
    lasting, late = drawn(surface, COUNTS._replace(light=0), light), drawn(surface, COUNTS, light, light_only=True)
    apart = (gather(traced(one, surface, lasting, None), light, COUNTS.light) + gather(traced(one, surface, late, None), light, 0)).sum(1)
    torch.testing.assert_close(apart, at_once, rtol=2e-3, atol=2e-3 * float(at_once.mean()))
    incoming = lookup(light.radiance, whole.direction.view(-1, 3)).view_as(whole.direction)
    plain = Samples(whole.direction, whole.density / sum(COUNTS))
    white = torch.ones(len(surface.index), 3)
    diffuse, _ = reflect_light(surface.view, surface.normal, white, surface.roughness, torch.zeros(len(white)), plain, incoming, False)
    torch.testing.assert_close(at_once[:, 9:] / torch.pi, diffuse, rtol=1e-3, atol=1e-3 * float(diffuse.mean()))


@pytest.mark.parametrize("backend", ["mesh", "gaussian"])
def test_what_is_met_is_as_bright_where_samples_of_the_light_leave_it_out(relighter, camera, light, backend):
    """The mean of the reflected light does not depend on which samples contribute it."""
    one, many = relighter(backend, (0.9, 0.7, 0.3, 0.5, 0.5)), tuple(16 * n for n in COUNTS)
    surface = one.surface(camera)
    ways = ((drawn(surface, (*many[:2], 0), light), many[2]), (drawn(surface, many, light), 0))
    apart, at_once = (
        (
            gather(traced(one, surface, samples), light, light_map_samples)
            - gather(traced(one, surface, samples, None), light, light_map_samples)
        ).sum((0, 1))
        for samples, light_map_samples in ways
    )
    assert (at_once[:9] > 0).all() and (at_once[9:] == 0).all()
    torch.testing.assert_close(apart[:9], at_once[:9], rtol=0.05, atol=0)


@pytest.mark.parametrize("backend", ["mesh", "gaussian"])
@pytest.mark.parametrize("degrees", [0.0, 123.0])
def test_light_samples_out_of_the_table_are_those_drawn(relighter, camera, backend, degrees):
    """Compare with drawing them one by one: the table rounds their direction by at most one of its cells."""
    light = prepare_light(np.linspace(0.5, 1.5, 64, dtype=np.float32)[None, :, None] * np.ones((32, 1, 3), np.float32)).turned(degrees)
    still = prepare_light(rotate(light.radiance.numpy(), degrees).astype(np.float32))
    one = relighter(backend, (0.9, 0.7, 0.3, 0.4, 0.5))
    surface = one.surface(camera)
    points, shift = points_of(surface)
    expected = gather(traced(one, surface, drawn(surface, COUNTS, still, light_only=True), None), still, 0)
    sums = torch.zeros_like(expected)
    above, asked = add_light_samples(sums, points, shift, COUNTS, light, VisibilityCache.unknown(len(shift)), one.query)
    assert above == asked and 0.3 * len(shift) * COUNTS.light < above < 0.8 * len(shift) * COUNTS.light
    torch.testing.assert_close(sums.mean(0), expected.mean(0), rtol=0.05, atol=0.02 * float(expected.mean()))
    if degrees == 0.0:  # else the turned light's samples are others
        assert ((sums - expected).abs().median(0).values < 0.03 * expected.mean(0)).all()


def test_rays_that_nothing_hides_are_not_traced_and_bring_the_light_itself(relighter, camera, light, engine):
    one = relighter("mesh", balls=((np.zeros(3), 1.0),))
    surface = one.surface(camera)
    points, shift = points_of(surface)
    unknown = VisibilityCache.unknown(len(shift))
    known = VisibilityCache(unknown.tile, torch.ones_like(unknown.clear))
    sums = torch.zeros(2, len(shift), 2, 12)
    asked = [add_light_samples(part, points, shift, COUNTS, light, o, one.query) for part, o in zip(sums, (unknown, known), strict=True)]
    assert asked[0][0] == asked[0][1] == asked[1][0] > 0
    assert asked[1][1] == (0 if engine == "numba" else asked[1][0])  # a device traces them all
    assert ((sums[0] - sums[1]).abs() < 1e-5).float().mean() > 0.99  # but for a few that meet the triangle next to theirs
