# SPDX-License-Identifier: GPL-3.0-or-later
"""Transmittance and radiance along secondary rays."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from irgspp.core.kernels.trace import transmittance
from irgspp.core.rendering.secondary_rays import OFFSET, SecondaryTracer
from irgspp.core.scene.dataset import Bound
from irgspp.core.scene.reconstruction import Reconstruction
from irgspp.core.scene.surroundings import Surroundings
from irgspp.core.shading.specular_albedo import specular_albedo

RADIANCE, SKY = np.array([0.6, 0.3, 0.1]), torch.tensor([1.0, 2.0, 3.0])


@pytest.fixture(scope="module")
def traced(splat_sphere):
    """Return a function (glossy, metallic, opacity) to a tracer of a unit sphere under a sky of one colour."""

    def make(glossy=False, metallic=0.0, opacity=0.999) -> SecondaryTracer:
        sphere = splat_sphere(6000, np.tile(RADIANCE, (6000, 1)), opacity)
        material = torch.tensor([0.5, 0.25, 0.75, 0.4, metallic]).clamp(1e-6, 1 - 1e-6)
        sphere.material = torch.logit(material)[:, None].repeat(1, 6000)
        return SecondaryTracer(Reconstruction(sphere, SKY.expand(8, 16, 3).contiguous(), Bound((0, 0, 0), 1.5), np.eye(4), glossy))

    return make


def rays(*rows):
    origin, direction = torch.tensor(rows, dtype=torch.float32).split(3, 1)
    return origin.contiguous(), torch.nn.functional.normalize(direction, dim=1)


AT_THE_SPHERE = rays((0, 0, 5, 0, 0, -1), (5, 0, 0.5, -1, 0, 0), (3, 3, 3, -1, -1, -1))
PAST_IT = rays((0, 0, 5, 0, 0, 1), (5, 0, 1.3, -1, 0, 0))


@pytest.mark.parametrize("glossy", [False, True])
def test_what_misses_is_free_and_dark(traced, glossy):
    free, radiance = traced(glossy).look(*PAST_IT)
    assert (free == 1).all() and (radiance == 0).all()


def test_what_hits_sees_the_spherical_harmonics(traced):
    free, radiance = traced().look(*AT_THE_SPHERE)
    assert (free == 0).all()
    np.testing.assert_allclose(radiance, np.tile(RADIANCE, (3, 1)), rtol=1e-4)


def test_radiance_counts_as_far_as_it_is_opaque(traced):
    origin, direction = AT_THE_SPHERE
    free, radiance = traced(opacity=0.01).look(origin, direction)
    assert (free > 0.3).all() and (free < 0.98).all()
    np.testing.assert_allclose(radiance, (1 - free)[:, None].numpy() * RADIANCE, rtol=1e-4)


@pytest.mark.parametrize("metallic", [0.0, 1.0])
@pytest.mark.parametrize("opacity", [0.999, 0.1])
def test_glossy_objects_reflect_the_sky(traced, metallic, opacity):
    origin, direction = AT_THE_SPHERE
    free, radiance = traced(True, metallic, opacity).look(origin, direction)
    n_v = torch.tensor([1.0, 0.75**0.5, 1.0])
    albedo = torch.tensor([[0.5, 0.25, 0.75]])
    mirrored = SKY * specular_albedo(n_v, torch.full((3,), 0.4), 0.04 * (1 - metallic) + metallic * albedo)
    expected = (1 - metallic) * torch.tensor(RADIANCE) + mirrored
    # Through thin surfels the far side shows as well: its normals, turned to the eye, are others.
    tolerance = 0.02 if opacity > 0.9 else 0.1
    np.testing.assert_allclose(radiance, (1 - free)[:, None] * expected, rtol=tolerance)


def test_rays_start_above_the_surfels_by_the_size_of_the_scene(traced):
    position, normal = rays((1, 0, 0, 1, 0, 0), (0, -1, 0, 0, -1, 0))
    tracer = traced()
    assert tracer.offset == pytest.approx(1.5 * OFFSET)
    np.testing.assert_allclose(tracer.above(position, normal), position * (1 + 1.5 * OFFSET), rtol=1e-6)
    free, _ = tracer.look(tracer.above(position, normal), normal)
    assert (free == 1).all()


def test_a_backdrop_hides_points_but_is_part_of_the_light(splat_sphere):
    """If the photographs show a background, surfels outside the bound belong to it."""
    sphere, wall = splat_sphere(6000, opacity=0.999), splat_sphere(6000, opacity=0.999)
    wall.position *= 4
    wall.log_scale += np.log(4)
    scene = Reconstruction(sphere.joined(wall), SKY.expand(8, 16, 3).contiguous(), Bound((0, 0, 0), 1.5), np.eye(4))
    for background, passes in ((None, 0.0), (scene.environment, 1.0)):
        tracer = SecondaryTracer(replace(scene, background=background))
        free, radiance = tracer.look(*rays((0, 0, 2, 0, 0, 1), (2, 0, 0, 1, 1, 1)))
        assert (free == passes).all() and ((radiance == 0).all() or not passes)
        assert (tracer.look(*rays((0, 0, 2, 0, 0, -1)))[0] == 0).all()
        assert (transmittance(tracer.tree, *rays((0, 0, 2, 0, 0, 1))) == 0).all()


@pytest.mark.parametrize("glossy", [False, True])
def test_surroundings_block_and_reflect_light(splat_sphere, glossy):
    sphere = splat_sphere(6000, np.tile(RADIANCE, (6000, 1)), 0.999)
    scene = Reconstruction(sphere, SKY.expand(8, 16, 3).contiguous(), Bound((0, 0, 0), 1.5), np.eye(4), glossy)
    x, y = np.meshgrid(np.arange(-4, 4, 0.1), np.arange(-4, 4, 0.1))
    table = np.stack([x.ravel(), y.ravel(), np.full(x.size, -1.2)], 1).astype(np.float32)
    up, shine = np.tile(np.float32([0, 0, 1]), (x.size, 1)), np.tile(np.float32([0.2, 0.5, 0.4]), (x.size, 1))
    tracer = SecondaryTracer(scene, Surroundings(table, up, shine, np.full(x.size, 0.1, np.float32)))
    free, radiance = tracer.look(*rays((2, 0.03, 0, 0, 0, -1), (-1.5, 1.57, 0.3, 0.2, 0, -1), (0, 0, 5, 0, 0, 1), (0, 0, 5, 0, 0, -1)))
    np.testing.assert_allclose(free, [0, 0, 1, 0], atol=0.03)
    tolerance = 0.15 if glossy else 0.02  # where the first stage has reflections, a table gets a dielectric's, of the sky above it
    np.testing.assert_allclose(radiance[:2], np.tile(shine[:1], (2, 1)), atol=tolerance)
    assert tracer.tree is not tracer._tree  # cameras look past the table
    assert len(SecondaryTracer(scene).look(*PAST_IT)[0]) == 2
