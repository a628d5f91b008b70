# SPDX-License-Identifier: GPL-3.0-or-later
"""Light and material told apart where both are known: a sphere on a floor, photographs by the model's own equations.

Visibility is known in closed form here, so nothing is traced.
"""

import math
from dataclasses import replace

import numpy as np
import pytest
import torch
from irgspp.core.shading.lightmap import texel_directions
from irgspp.core.shading.specular_albedo import diffuse_share
from irgspp.core.stages import separation as module
from irgspp.core.stages.observations import Observations
from irgspp.core.stages.separation import STEPS, Separation, gram, neighbourhood, view_terms
from irgspp.core.stages.transfer import Transfer, subdivided_directions

HEIGHT = 8
TEXELS = 2 * HEIGHT**2
FLOOR, FLOOR_RADIUS = -1.0, 3.0
GLOW = np.array([0.15, 0.12, 0.1], np.float32)  # radiance of what is in the way


def unit(rows):
    return rows / np.linalg.norm(rows, axis=-1, keepdims=True)


def surface(random, on_sphere=300, on_floor=150):
    """Positions and normals, of the sphere's upper part only: cameras are above."""
    sphere = unit(random.normal(size=(on_sphere, 3)))
    sphere = sphere[sphere[:, 2] > -0.7]
    floor = np.concatenate([random.uniform(-2, 2, (on_floor, 2)), np.full((on_floor, 1), FLOOR)], 1)
    normal = np.concatenate([sphere, np.tile([0.0, 0.0, 1.0], (on_floor, 1))])
    return np.concatenate([sphere, floor]).astype(np.float32), normal.astype(np.float32)


def blocked(position, normal, direction):
    """(P, D) whether sphere or floor are in the way."""
    start = position + 1e-3 * normal
    along = start @ direction
    sphere = (along < 0) & (along**2 > (start**2).sum(1)[:, None] - 1)
    down = np.where(direction[2] < -1e-6, direction[2], np.nan)
    distance = (FLOOR - start[:, 2:]) / down
    where = start[:, None, :2] + distance[..., None] * direction[:2].T
    return sphere | ((distance > 0) & ((where**2).sum(-1) < FLOOR_RADIUS**2))


def transport(position, normal):
    direction, angle = subdivided_directions(HEIGHT, 2, 0)
    cosine = np.maximum(normal @ direction, 0)
    free = (cosine > 0) & ~blocked(position, normal, direction)
    visible = free.astype(np.float32)
    other = ((cosine > 0) & ~free)[:, None].astype(np.float32) * GLOW[:, None]
    weight = cosine * angle / math.pi
    irradiance = torch.from_numpy((weight * visible).reshape(len(position), 4, TEXELS).sum(1))
    return Transfer(HEIGHT, (direction, angle, visible, other), irradiance, torch.from_numpy(np.einsum("pd,pcd->pc", weight, other)), True)


def soft_light():
    """(T, 3) a sky with lamps of several sizes and colours."""
    light = torch.full((TEXELS, 3), 0.25)
    direction = texel_directions(HEIGHT, 2 * HEIGHT).reshape(-1, 3)
    lamps = (
        ((1, 0.5, 0.8), (8, 6, 4), 12),
        ((-1, 0.2, 0.3), (1, 2, 4), 6),
        ((0, -1, 0.6), (3, 3, 2), 20),
        ((0.3, 0.9, -0.3), (1, 0.5, 0.5), 4),
    )
    for axis, colour, sharpness in lamps:
        towards = torch.from_numpy(unit(np.array(axis, float))).float()
        light += (direction @ towards).clamp_min(0)[:, None] ** sharpness * torch.tensor(colour)
    return light


def known_materials(position):
    """Albedo (P, 3), roughness, metallic (P,): a half red and half blue sphere with a brass cap, on a grey floor."""
    floor, cap = position[:, 2] == FLOOR, position[:, 2] > 0.4
    albedo = np.where(position[:, :1] > 0, [0.7, 0.2, 0.15], [0.2, 0.35, 0.6])
    albedo = np.where(cap[:, None], [0.9, 0.7, 0.4], np.where(floor[:, None], 0.5, albedo))
    roughness = np.where(cap, 0.25, np.where(floor, 0.7, 0.4))
    return tuple(torch.from_numpy(np.asarray(a, np.float32)) for a in (albedo, roughness, cap))


def photographed(transfer, position, normal, views=8):
    """Points and views by the model, and the truth: light, albedo, roughness, metallic."""
    random = np.random.default_rng(1)
    cameras = unit(random.normal(size=(40, 3)))
    toward = unit(5 * cameras * [1, 1, 0] + 5 * np.abs(cameras) * [0, 0, 1] - position[:, None])
    facing = np.einsum("pkc,pc->pk", toward, normal) > 0.2
    pairs = [(p, k) for p in range(len(position)) for k in random.permutation(np.flatnonzero(facing[p]))[:views]]
    point, camera = np.array(pairs).T
    view = torch.from_numpy(toward[point, camera].astype(np.float32))
    dark = torch.zeros(len(point), 3)
    seen = Observations(torch.from_numpy(position), torch.from_numpy(normal), torch.from_numpy(point), view, dark, dark.bool())
    truth = (soft_light(), *known_materials(position))
    return replace(seen, colour=rendered(seen, transfer, *truth)), truth


def rendered(seen, transfer, light, albedo, roughness, metallic):
    """(K, 3) what the views show."""
    point = seen.point
    scaled, added, rest_scaled, rest_added = transfer.rows(seen, roughness)
    irradiance = (transfer.irradiance @ light + transfer.indirect)[point]
    share = diffuse_share((seen.normal[point] * seen.view).sum(1), roughness[point])[:, None]
    metal = metallic[point, None]
    specular = scaled @ light + rest_scaled
    f0 = 0.04 * (1 - metal) + metal * albedo[point]
    return (1 - metal) * albedo[point] * share * irradiance + f0 * specular + added @ light + rest_added


def make(*counts):
    position, normal = surface(np.random.default_rng(0), *counts)
    transfer = transport(position, normal)
    return transfer, *photographed(transfer, position, normal)


@pytest.fixture(scope="module")
def scene():
    """Transfer, observations and the truth."""
    return make()


@pytest.fixture(scope="module")
def halfway():
    """A small problem after some steps, and what one could solve for: weight, anchor, pull."""
    transfer, seen, _ = make(40, 15)
    separation = start(seen, transfer)
    separation.run(lambda step: step == 9)
    separation.metallic[::3] = 0.5  # all terms at once
    separation._trace_lobes()
    random = torch.Generator().manual_seed(5)
    weight = torch.rand(seen.colour.shape, generator=random)
    pull = 0.1 + torch.rand(separation.albedo.shape, generator=random)
    return separation, weight, separation.albedo.clone(), pull


def start(seen, transfer, seed=0):
    count = len(seen.position)
    return Separation(seen, transfer, torch.full((count,), 0.5), torch.zeros(count), seed)


def solved(seen, transfer, seed=0):
    separation = start(seen, transfer, seed)
    separation.run()
    return separation


@pytest.fixture(scope="module")
def found(scene):
    transfer, seen, _ = scene
    return solved(seen, transfer)


def rescaled(separation, truth):
    """Light and albedo with the one factor that photographs can't tell taken out."""
    scale = (truth[1] / separation.albedo).median(0).values
    return separation.light / scale, separation.albedo * scale, scale


def psnr(light, truth):
    """dB of light below the brightest that is there."""
    return float(-10 * ((light - truth).square().mean() / truth.max() ** 2).log10())


def test_albedo_is_found_up_to_one_factor(scene, found):
    _, albedo, scale = rescaled(found, scene[2])
    error = (albedo / scene[2][1] - 1).abs()
    assert error.median() < 0.01 and error.quantile(0.95) < 0.05 and error.max() < 0.15
    assert (scale - 1).abs().max() < 0.2  # even that one, as metals and dielectrics share the light


def test_light_is_found(scene, found):
    light, _, _ = rescaled(found, scene[2])
    assert psnr(light, scene[2][0]) > 32
    assert (light.log() - scene[2][0].log()).abs().median() < 0.05


def test_gloss_is_found(scene, found):
    _, _, roughness, metallic = scene[2]
    assert torch.equal(found.metallic, metallic)
    assert (found.roughness - roughness).abs().max() < 0.05


def test_metal_is_found_only_where_it_is_looked_for(scene):
    transfer, seen, _ = scene
    separation = Separation(seen, transfer, torch.full((len(seen.position),), 0.5), torch.zeros(len(seen.position)), 0, (0.0,))
    separation.run(lambda done: done == max(module.MATERIAL_STEPS[:2]) + 1)
    assert (separation.metallic == 0).all() and separation.roughness.std() > 0.05


def test_photographs_are_explained(scene, found):
    assert found.error() < 0.003
    transfer, seen, _ = scene
    assert found.error() < 0.1 * start(seen, transfer).error()


def test_without_knowing_what_is_in_the_way_albedo_is_wrong(scene, found):
    """The same with all of the hemisphere free: what the test above finds, it finds by the shadows."""
    transfer, seen, truth = scene
    direction, angle, _, other = transfer.fixed
    everything = (seen.normal.numpy() @ direction > 0).astype(np.float32)
    irradiance = (np.maximum(seen.normal.numpy() @ direction, 0) * angle / math.pi).reshape(-1, 4, TEXELS).sum(1)
    blind = Transfer(HEIGHT, (direction, angle, everything, 0 * other), torch.from_numpy(irradiance), 0 * transfer.indirect, False)
    errors = [(rescaled(s, truth)[1] / truth[1] - 1).abs().mean() for s in (found, solved(seen, blind))]
    assert errors[1] > 4 * errors[0]


def test_same_seed_same_bits(scene, found):
    transfer, seen, _ = scene
    again = solved(seen, transfer)
    for name in ("light", "albedo", "roughness", "metallic"):
        assert torch.equal(getattr(found, name), getattr(again, name)), name


def test_clipped_highlights_are_lower_bounds(scene):
    """Told that values are clipped, they don't make the lamps dim."""
    transfer, seen, truth = scene
    clipped = replace(seen, colour=seen.colour.clamp_max(0.6), saturated=seen.colour > 0.6)
    assert 0.05 < clipped.saturated.float().mean() < 0.3
    told, untold = (rescaled(solved(s, transfer), truth)[0] for s in (clipped, replace(clipped, saturated=seen.saturated)))
    assert psnr(told, truth[0]) > psnr(untold, truth[0]) + 3
    brightest = truth[0] > 0.5 * truth[0].max()
    assert told[brightest].mean() > 0.8 * truth[0][brightest].mean() and untold[brightest].mean() < 0.8 * truth[0][brightest].mean()


def test_views_that_do_not_fit_lose_their_say(scene, found):
    """One view in thirty shows something else."""
    transfer, seen, truth = scene
    wrong = torch.rand(len(seen.point), 1, generator=torch.Generator().manual_seed(0)) < 1 / 30
    other = torch.rand(seen.colour.shape, generator=torch.Generator().manual_seed(1))
    albedo = rescaled(solved(replace(seen, colour=torch.where(wrong, other, seen.colour)), transfer), truth)[1]
    error = (albedo / truth[1] - 1).abs()
    assert error.median() < 0.02 and error.quantile(0.9) < 0.1


def test_steps_are_told_and_can_end_the_work(scene):
    transfer, seen, _ = scene
    told = []
    separation = start(seen, transfer)
    separation.run(lambda done: told.append(done) or done == 2)
    assert told == [1, 2]

    def stop(done):
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        start(seen, transfer).run(stop)
    assert max(module.MATERIAL_STEPS) + 1 < STEPS  # the light follows the materials


def model(separation, light, channel):
    """c and d (K,) of one channel, float64, differentiable in the light."""
    transfer, point = separation.transfer, separation.seen.point
    rows = [a.double() for a in transfer.rows(separation.seen, separation.roughness)]
    irradiance = (transfer.irradiance.double() @ light + transfer.indirect[:, channel].double())[point]
    lobe = [row @ light + own[:, channel] for row, own in zip(rows[:2], rows[2:], strict=True)]
    return view_terms(separation.metallic[point].double(), separation.share[:, 0].double(), irradiance, *lobe)


def eliminated(separation, log_light, weight, anchor, pull, channel):
    """Residuals of views and of albedo's prior, weighted, with the best albedo for a light, float64; that albedo, and c."""
    point, y = separation.seen.point, separation.seen.colour[:, channel].double()
    factor, rest = model(separation, log_light.exp(), channel)
    weight, anchor, pull = (t[:, channel].double() for t in (weight, anchor, pull))
    sums = lambda values: torch.zeros_like(pull).index_add(0, point, values)  # noqa: E731
    albedo = (sums(weight * factor * (y - rest)) + pull * anchor) / (sums(weight * factor**2) + pull)
    return torch.cat([weight.sqrt() * (albedo[point] * factor + rest - y), pull.sqrt() * (albedo - anchor)]), albedo, factor


def equations(separation, weight, anchor, pull, channel):
    """What the module solves, by the logarithm of the light, and what it should: half the squared residuals per view."""
    log_light = separation.light[:, channel].double().log().requires_grad_()
    residuals, albedo, factor = eliminated(separation, log_light, weight, anchor, pull, channel)
    separation.albedo[:, channel] = albedo.detach().float()
    total = separation.seen.sums(weight[:, channel] * factor.detach().float() ** 2) + pull[:, channel]
    views = len(separation.seen.point)
    error = (residuals[:views] / weight[:, channel].double().sqrt()).detach().float()
    normal, slope = separation._equations(channel, weight[:, channel], factor.detach().float(), total, error)
    light = separation.light[:, channel]
    return light[:, None] * normal * light, light * slope, log_light, residuals


@pytest.mark.parametrize("channel", [0, 2])
def test_slope_is_the_derivative_of_the_error_with_albedo_eliminated(halfway, channel):
    _, slope, log_light, residuals = equations(*halfway, channel)
    (expected,) = torch.autograd.grad(residuals.square().sum() / 2 / len(halfway[0].seen.point), log_light)
    assert expected.abs().max() > 1e-5
    np.testing.assert_allclose(slope, expected, rtol=1e-3, atol=1e-4 * float(expected.abs().max()))


def test_curvature_is_that_of_gauss_and_newton_with_albedo_eliminated(halfway):
    """By the Jacobian of light and albedo together and its Schur complement, dense."""
    separation, weight, anchor, pull = halfway
    normal, _, log_light, _ = equations(separation, weight, anchor, pull, 1)

    def residuals(unknowns):
        """Of light (its logarithm) and albedo as independent unknowns; the albedo's anchor makes no difference."""
        albedo = unknowns[TEXELS:]
        factor, rest = model(separation, unknowns[:TEXELS].exp(), 1)
        views = weight[:, 1].double().sqrt() * (albedo[separation.seen.point] * factor + rest)
        return torch.cat([views, pull[:, 1].double().sqrt() * albedo])

    albedo = separation.albedo[:, 1].double()
    jacobian = torch.autograd.functional.jacobian(residuals, torch.cat([log_light.detach(), albedo]), vectorize=True)
    full = jacobian.T @ jacobian / len(separation.seen.point)
    by_light, mixed, by_albedo = full[:TEXELS, :TEXELS], full[:TEXELS, TEXELS:], full[TEXELS:, TEXELS:]
    expected = by_light - mixed @ torch.linalg.solve(by_albedo, mixed.T)
    np.testing.assert_allclose(normal, expected, atol=1e-5 * float(expected.abs().max()))
    assert torch.linalg.eigvalsh(normal.double()).min() > -1e-6 * float(expected.abs().max())


def test_gram_is_the_product():
    rows = torch.randn(50, 200, generator=torch.Generator().manual_seed(0))
    np.testing.assert_allclose(gram(rows), rows.T @ rows, atol=1e-4)
    assert torch.equal(gram(rows), gram(rows).T)


def test_laplacian_sums_squared_differences_of_neighbours():
    height, width = 4, 8
    light = np.random.default_rng(0).random((height, width))
    expected = 0.0
    for i in range(height):
        for j in range(width):
            expected += (light[i, j] - light[i, (j + 1) % width]) ** 2  # around, across the seam
            expected += (light[i, j] - light[i + 1, j]) ** 2 if i + 1 < height else 0.0
    form, values = module._laplacian(height).double(), torch.from_numpy(light.reshape(-1))
    assert float(values @ form @ values) == pytest.approx(expected, rel=1e-6)
    assert torch.equal(form, form.T) and (form.sum(1) == 0).all()


def test_vertex_of_a_parabola():
    knots = torch.arange(6.0)
    vertices = torch.tensor([0.0, 0.4, 1.0, 2.3, 3.5, 4.9, 5.0])
    cost = 2 * (knots - vertices[:, None]) ** 2 + 1
    np.testing.assert_allclose(module._vertex(knots, cost), vertices, atol=1e-5)


def test_vertex_stays_within_the_knots():
    knots = torch.tensor([0.1, 0.2, 0.4, 0.8])
    falling, rising, flat = torch.tensor([4.0, 3.0, 2.0, 1.0]), torch.tensor([1.0, 2.0, 3.0, 4.0]), torch.ones(4)
    hollow = torch.tensor([5.0, 1.0, 2.0, 5.0])  # knots are not evenly spread: towards 0.4 steps are longer
    found = module._vertex(knots, torch.stack([falling, rising, flat, hollow]))
    assert found[:2].tolist() == pytest.approx([0.8, 0.1])
    assert 0.1 <= found[2] <= 0.4 and 0.2 < found[3] < 0.3


def test_neighbours_are_near_and_count_by_likeness_of_colour():
    random = np.random.default_rng(0)
    position = torch.from_numpy(random.random((200, 3)).astype(np.float32))
    colour = torch.where(position[:, :1] > 0.5, torch.tensor([0.8, 0.1, 0.1]), torch.tensor([0.1, 0.2, 0.7]))
    index, share = neighbourhood(position, colour)
    distance = torch.cdist(position, position)
    assert torch.equal(index[:, 0], torch.arange(200))
    np.testing.assert_allclose(distance.gather(1, index), distance.sort(1).values[:, : module.NEIGHBOURS], atol=1e-5)
    np.testing.assert_allclose(share.sum(1), 1, rtol=1e-5)
    other = (position[:, :1] > 0.5) != (position[index][..., 0] > 0.5)
    assert other.any() and share[other].max() < 1e-3
    np.testing.assert_allclose(share[~other.any(1)], 1 / module.NEIGHBOURS, rtol=1e-5)


def test_few_points_are_all_neighbours():
    index, share = neighbourhood(torch.rand(1, 3), torch.rand(1, 3))
    assert index.shape == share.shape == (1, 1) and share.item() == 1
