# SPDX-License-Identifier: GPL-3.0-or-later
"""The gathering kernel against its twin in plain operations, and against the rendering equation's other estimate."""

import numpy as np
import pytest
import torch
from irgspp.core.relight.gathering import gather, gather_reference, trace_samples
from irgspp.core.relight.lighting import prepare
from irgspp.core.shading.lightmap import lookup
from irgspp.core.shading.lights import studio_light
from irgspp.core.shading.sampling import Samples, draw
from irgspp.core.shading.transport import reflect_light

COUNTS = (9, 6, 5)
SCALE = torch.tensor([1.0, 0.8, 0.6])


@pytest.fixture
def light():
    """Brighter at one side than at the other, of unequal size to what it is reduced to."""
    return prepare(studio_light(40, 80) * np.linspace(0.5, 1.5, 80, dtype=np.float32)[None, :, None])


def samples_of(surface, counts, light, **how):
    points = (surface.view, surface.normal, surface.roughness)
    shift = torch.rand(len(surface.index), 2, generator=torch.Generator().manual_seed(0))
    drawn = draw(*points, counts, light.distribution, shift, **how)
    return Samples(drawn.direction, drawn.density * sum(counts))


@pytest.mark.parametrize("backend", ["mesh", "gaussian"])
@pytest.mark.parametrize("material", [(0.6, 0.4, 0.2, 0.7, 0.0), (0.9, 0.7, 0.3, 0.2, 1.0)])
@pytest.mark.parametrize(("scale", "share"), [(SCALE, 0), (SCALE, 5), (None, 5)])
def test_equals_the_twin(relighter, camera, light, backend, material, scale, share):
    one = relighter(backend, material)
    surface = one.surface(camera)
    samples = samples_of(surface, (*COUNTS[:2], 0) if share else COUNTS, light)
    rays = trace_samples(one.query, surface.origin, surface.normal, samples, scale, conserving=True)
    assert 0 < len(rays.opacity) < rays.row.numel() and rays.size > 20 * rays.row.numel()
    points = (surface.view, surface.normal, surface.roughness)
    found, expected = (function(*points, rays, light, share) for function in (gather, gather_reference))
    scaled = (found - expected).abs() / expected.abs().mean(0)
    assert scaled.quantile(0.999) < 2e-3 and scaled.mean() < 1e-4


def test_parts_of_the_mixture_come_to_the_whole(relighter, camera, light):
    """Lasting and light samples apart, added, are all samples at once, and with nothing in the way what `reflect_light` estimates."""
    one = relighter("mesh", balls=((np.zeros(3), 1.0),))
    surface = one.surface(camera)
    points = (surface.view, surface.normal, surface.roughness)

    def traced(samples):
        return trace_samples(one.query, surface.origin, surface.normal, samples, SCALE, conserving=True)

    whole = samples_of(surface, COUNTS, light)
    at_once = gather(*points, traced(whole), light, 0).sum(1)
    lasting, late = samples_of(surface, (*COUNTS[:2], 0), light), samples_of(surface, COUNTS, light, light_only=True)
    apart = (gather(*points, traced(lasting), light, COUNTS[2]) + gather(*points, traced(late), light, 0)).sum(1)
    torch.testing.assert_close(apart, at_once, rtol=2e-3, atol=2e-3 * float(at_once.mean()))
    incoming = lookup(light.radiance, whole.direction.view(-1, 3)).view_as(whole.direction)
    plain = Samples(whole.direction, whole.density / sum(COUNTS))
    white = torch.ones(len(surface.index), 3)
    diffuse, _ = reflect_light(*points[:2], white, surface.roughness, torch.zeros(len(white)), plain, incoming, conserving=False)
    torch.testing.assert_close(at_once[:, 9:] / torch.pi, diffuse, rtol=1e-3, atol=1e-3 * float(diffuse.mean()))
