# SPDX-License-Identifier: GPL-3.0-or-later
"""Texels of the light of several sizes: they cover the sphere, know their neighbours, and lie on a map where they belong."""

import math

import numpy as np
import pytest
import torch
from irgspp.core.kernels.constants import PER_STRATUM
from irgspp.core.shading.environment_lookup import direction_to_uv
from irgspp.core.stages.common.light_map import resized_light
from irgspp.core.stages.second.solver.light_texels import LightTexels


@pytest.mark.parametrize(("height", "side"), [(4, 1), (8, 2), (6, 3)])
def test_directions_lie_in_their_texels(height, side):
    direction, angle = LightTexels.uniform(height).directions(side, 7)
    u, v = direction_to_uv(torch.from_numpy(direction.T).double())
    texel = (v * height).long() * 2 * height + (u * 2 * height).long()
    assert torch.equal(texel, torch.arange(2 * height**2).repeat(side**2))
    np.testing.assert_allclose(np.linalg.norm(direction, axis=0), 1, atol=1e-6)
    assert angle.sum() == pytest.approx(4 * math.pi, rel=1e-5)


def test_directions_come_of_the_seed():
    assert np.array_equal(LightTexels.uniform(4).directions(2, 1)[0], LightTexels.uniform(4).directions(2, 1)[0])
    assert not np.array_equal(LightTexels.uniform(4).directions(2, 1)[0], LightTexels.uniform(4).directions(2, 2)[0])


def chosen(texels, *numbers):
    """Return the mask of some texels."""
    mask = np.zeros(texels.count, bool)
    mask[list(numbers)] = True
    return mask


@pytest.fixture
def split():
    """Texels of a map of 4 x 8, two of which are split, and one of their parts again."""
    once, _, _ = LightTexels.uniform(4).split(chosen(LightTexels.uniform(4), 10, 20))
    return once.split(chosen(once, once.count - 1))[0]


def test_parts_cover_the_texel_that_was_split():
    whole = LightTexels.uniform(4)
    texels, new, old = whole.split(chosen(whole, 3, 17))
    assert texels.count == whole.count + 6 and new.count == 8 and (texels.level[-8:] == 1).all()
    np.testing.assert_allclose(np.bincount(old, texels.solid_angles), whole.solid_angles, rtol=1e-12)
    direction, _ = texels.directions(2, 0)
    u, v = direction_to_uv(torch.from_numpy(direction.T).double())
    inside = (v * 4).long() * 8 + (u * 8).long()
    assert torch.equal(inside, torch.from_numpy(np.tile(old, 4)))


def test_directions_lie_in_texels_of_all_sizes(split):
    direction, angle = split.directions(3, 5)
    u, v = direction_to_uv(torch.from_numpy(direction.T).double())
    painted = torch.from_numpy(split._painted())
    rows = len(painted)
    assert torch.equal(painted[(v * rows).long(), (u * 2 * rows).long()], torch.arange(split.count).repeat(9))
    assert angle.sum() == pytest.approx(4 * math.pi, rel=1e-5)


def test_neighbours_of_equal_size_are_one_edge_apart():
    pairs, weight, distance = LightTexels.uniform(4).pairs
    assert len(pairs) == 4 * 8 + 3 * 8 and (weight == 1).all()
    np.testing.assert_allclose(distance, math.pi / 4)


def test_neighbours_of_other_sizes_share_the_edge_of_the_smaller():
    whole = LightTexels.uniform(4)
    texels, _, old = whole.split(chosen(whole, 10))
    pairs, weight, distance = texels.pairs
    small = texels.level > 0
    kinds = small[pairs].sum(1)
    np.testing.assert_allclose(weight[kinds == 1], 0.5 / 0.75)
    np.testing.assert_allclose(distance[kinds == 1], 0.75 * math.pi / 4)
    np.testing.assert_allclose(weight[kinds == 2], 1)
    assert (kinds == 1).sum() == 8 and (kinds == 2).sum() == 4  # two at each side, and the four among themselves
    around = set(old[pairs[kinds == 1]].ravel()) - {10}
    assert around == {2, 9, 11, 18}


def test_map_of_equal_texels_is_interpolated():
    values = torch.rand(32, 3, generator=torch.Generator().manual_seed(0))
    assert torch.equal(LightTexels.uniform(4).map(values, 4), values.view(4, 8, 3))
    assert torch.equal(LightTexels.uniform(4).map(values, 16), resized_light(values.view(4, 8, 3), 16))


def test_a_lamp_in_a_small_texel_does_not_spread_on_the_map(split):
    lamp = int(np.flatnonzero(split.level == 2)[0])
    values = torch.full((split.count, 1), 0.5)
    values[lamp] = 100.0
    image = split.map(values, 16)[..., 0]
    assert float(image[split.row[lamp], split.column[lamp]]) == 100
    assert ((image - 0.5).abs() > 1e-6).sum() == 1


def test_a_bright_texel_is_split_until_it_is_small():
    texels, light = LightTexels.uniform(4), torch.full((32, 3), 0.5)
    light[11] = 9.0
    for _ in range(2):
        picked = texels.brightest(light, 16, 1)
        assert np.flatnonzero(picked).tolist() == [int(light[:, 0].argmax())]
        texels, _, _ = texels.split(picked)
        light = torch.full((texels.count, 3), 0.5)
        light[-2] = 9.0
    lamp = int(light[:, 0].argmax())
    assert texels.level[lamp] == 2 and not texels.brightest(light, 16, 1)[lamp]


def test_none_is_split_where_all_are_small_enough():
    texels = LightTexels.uniform(4)
    assert [int(texels.brightest(torch.rand(32, 3), rows, 8).sum()) for rows in (4, 7, 8)] == [0, 0, 8]


def test_parts_of_a_texel_have_one_colour_and_keep_their_power(split):
    light = torch.rand(split.count, 3, generator=torch.Generator().manual_seed(1)) + 0.1
    changed = split.with_one_colour(light)
    power, after = (torch.from_numpy(split.solid_angles)[:, None] * one.double() for one in (light, changed))
    np.testing.assert_allclose(after.sum(0), power.sum(0), rtol=1e-6)
    parts = np.flatnonzero((split.level == 1) & (split.row // 2 == 1))
    ratio = changed[parts] / changed[parts].mean(1, keepdim=True)
    np.testing.assert_allclose(ratio, ratio[:1].expand_as(ratio), rtol=1e-5)
    np.testing.assert_allclose(changed.mean(1), light.mean(1), rtol=1e-5)
    np.testing.assert_allclose(changed[split.level == 0], light[split.level == 0], rtol=1e-5)


@pytest.mark.parametrize("side", [1, 2])
def test_directions_within_a_stratum_surround_it(split, side):
    """They lie in the texel of the stratum, spread over it, and their mean is about its middle: that of many random directions in it."""
    _, angle = split.directions(side, 0)
    inner = split.strata(side)
    assert inner.shape == (len(angle), 3, PER_STRATUM) and inner.dtype == np.float32
    np.testing.assert_allclose(np.linalg.norm(inner, axis=1), 1, atol=1e-6)
    u, v = direction_to_uv(torch.from_numpy(inner).double().transpose(1, 2).reshape(-1, 3))
    rows = split.height << np.tile(split.level, side**2)[:, None]
    places = [(size * part.reshape(-1, PER_STRATUM).numpy()).astype(int) for size, part in ((rows, v), (2 * rows, u))]
    for place, of_texel in zip(places, (split.row, split.column), strict=True):
        assert (place == np.tile(of_texel, side**2)[:, None]).all()
    many = np.mean([split.directions(side, seed)[0] for seed in range(400)], 0)
    size = np.sqrt(angle)
    assert (np.linalg.norm(inner.mean(2).T - many, axis=0) < 0.08 * size).all()
    assert (inner.std(2).max(1) > 0.15 * size).all()


def test_a_direction_is_found_in_its_texel(split):
    direction, _ = split.directions(3, 5)
    assert np.array_equal(split.containing(direction.T.astype(np.float64)), np.tile(np.arange(split.count), 9))
    assert len(split.containing(np.zeros((0, 3)))) == 0
