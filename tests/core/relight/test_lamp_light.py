# SPDX-License-Identifier: GPL-3.0-or-later
"""Light of lamps on reconstructions: shadows, backends, precision, mixture of samples, frames of the cache."""

from types import SimpleNamespace

import numpy as np
import pytest
import torch
from irgspp.core.relight.indirect_light import ShadingPoints
from irgspp.core.relight.lamp_light import lamp_sums, samples_per_lamp
from irgspp.core.relight.prepared_light import prepare_light
from irgspp.core.relight.sample_counts import SampleCounts
from irgspp.core.scene.lamps import Lamp
from irgspp.core.shading.procedural_lights import studio_light

BACKENDS = ("mesh", "gaussian")
BLACK = prepare_light(np.zeros((8, 16, 3), np.float32))
STUDIO = prepare_light(studio_light(16, 32))
OVERHEAD = Lamp("point", (1, 0, 0, 0.4, 0, 1, 0, -1.5, 0, 0, 1, 3, 0, 0, 0, 1), (12.0, 12.0, 12.0), radius=0.3)
FREE = SimpleNamespace(hidden=lambda origin, direction, reach=None: torch.zeros(len(origin)))


def placed(x, y, z):
    return (1.0, 0.0, 0.0, x, 0.0, 1.0, 0.0, y, 0.0, 0.0, 1.0, z, 0.0, 0.0, 0.0, 1.0)


@pytest.mark.parametrize("backend", BACKENDS)
def test_occluders_behind_a_lamp_cast_no_shadow(relighter, backend):
    query = relighter(backend).query  # balls at the origin (radius 1) and at (1.1, 0, 1.1)
    origin, direction = torch.tensor([[0.0, 0.0, 4.0]] * 3), torch.tensor([[0.0, 0.0, -1.0]] * 3)
    hidden = query.hidden(origin, direction, torch.tensor([2.5, 3.5, torch.inf]))
    assert torch.allclose(hidden, torch.tensor([0.0, 1.0, 1.0]), atol=0.02)


@pytest.mark.parametrize("backend", BACKENDS)
def test_points_above_hits_are_above_the_hit_surface(relighter, backend):
    hits = relighter(backend).query.hits(torch.tensor([[0.0, -4.0, 0.0]]), torch.tensor([[0.0, 1.0, 0.0]]))
    assert torch.allclose(hits.point, torch.tensor([[0.0, -1.0, 0.0]]), atol=0.1) and hits.point[0, 1] < -1.0


def test_backends_agree(relighter, camera):
    images = []
    for backend in BACKENDS:
        one = relighter(backend, mesh_normals=0.0)
        images.append(one.relit(one.surface(camera), BLACK, [OVERHEAD]))
    assert images[0][..., :3].mean() > 0.02
    assert (images[0] - images[1]).abs().mean() < 0.04 * images[0].mean()


def test_a_lamp_between_two_balls_is_shadowed_by_the_nearer_alone(relighter, camera):
    lit, apart = relighter("mesh", denoise="off", indirect=False), relighter("mesh", balls=((np.zeros(3), 1.0),), denoise="off")
    above = Lamp("point", placed(1.1, 0.0, 3.0), (20.0, 20.0, 20.0))
    shadowed = lit.relit(lit.surface(camera), BLACK, [above])
    alone = apart.relit(apart.surface(camera), BLACK, [above])
    solid = (shadowed[..., 3] > 0.99) & (alone[..., 3] > 0.99)
    assert (alone[..., :3] - shadowed[..., :3])[solid].min() > -1e-4 and (alone - shadowed)[solid].max() > 0.1


def test_lamps_add_to_the_light_map(relighter, camera):
    one = relighter("mesh", denoise="off")
    surface = one.surface(camera)
    together, lamp, world = (one.relit(surface, *light) for light in ((STUDIO, [OVERHEAD]), (BLACK, [OVERHEAD]), (STUDIO, ())))
    assert torch.allclose(together[..., :3], (lamp + world)[..., :3], atol=1e-5) and world.max() > 0.1
    twice = one.relit(surface, BLACK, [OVERHEAD, OVERHEAD])
    assert torch.allclose(twice[..., :3], 2 * lamp[..., :3], atol=1e-5)


def test_the_same_image_whatever_was_rendered_before(relighter, camera):
    first, second = relighter("mesh"), relighter("mesh")
    surface, same = first.surface(camera), second.surface(camera)
    first.relit(surface, STUDIO)
    assert torch.equal(first.relit(surface, STUDIO, [OVERHEAD]), second.relit(same, STUDIO, [OVERHEAD]))
    assert torch.equal(first.relit(surface, STUDIO), relighter("mesh").relit(same, STUDIO))


def test_samples_for_an_error_count_lamps(relighter, camera):
    one, many = relighter("mesh", error=0.01), relighter("mesh", samples=1024)
    image = one.relit(one.surface(camera), STUDIO, [OVERHEAD])
    assert (image - many.relit(many.surface(camera), STUDIO, [OVERHEAD])).abs().mean() < 0.01


@pytest.mark.parametrize("brdf", ["principled", "irgs"])
@pytest.mark.parametrize("roughness", [0.05, 0.3, 0.9])
def test_few_samples_have_the_mean_of_many(roughness, brdf):
    """The mixture of lamp and visible-normal samples is unbiased, for mirrors under a large lamp too, in single and double precision."""
    count = 4000
    normal, view = (
        torch.nn.functional.normalize(torch.tensor(v, dtype=torch.float64), dim=0).expand(count, 3)
        for v in ((0.1, -0.2, 1.0), (0.3, -0.6, 0.8))
    )
    points = ShadingPoints.from_roughness(torch.zeros_like(view), view, normal, torch.full((count,), roughness).double(), brdf)
    single = ShadingPoints(*(t.float() for t in points.tensors), brdf)
    shift = torch.rand(count, 2, generator=torch.Generator().manual_seed(0)).double()
    lamp = Lamp("area", (1, 0, 0, 0.2, 0, 0.8, -0.6, 0.9, 0, 0.6, 0.8, 1.5, 0, 0, 0, 1), (2.0, 3.0, 4.0), size=(1.5, 1.0))
    few = lamp_sums(points, [lamp], shift, 4, FREE).sum(1)
    few_single = lamp_sums(single, [lamp], shift.float(), 4, FREE).sum(1)
    many = lamp_sums(ShadingPoints(*(t[:1] for t in points.tensors), brdf), [lamp], shift[:1], 1 << 16, FREE).sum(1)[0]
    assert torch.allclose(few_single.double().mean(0), few.mean(0), rtol=1e-3, atol=1e-4)
    error = few.std(0) / count**0.5
    assert ((few.mean(0) - many).abs() < 4 * error + 2e-3 * many.abs().max()).all()
    assert (few.std(0)[1] < 3 * many[1]).all()  # lamp samples alone would miss the mirror's lobe


def test_lamps_share_the_samples():
    assert [samples_per_lamp(SampleCounts(8, 8, 16), lamps) for lamps in (1, 2, 4, 40)] == [16, 16, 8, 4]
    assert samples_per_lamp(SampleCounts(1, 0, 0), 1) == 4
