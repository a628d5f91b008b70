# SPDX-License-Identifier: GPL-3.0-or-later
"""Metal grows from clear evidence over points that do not contradict it, and is kept by regions that explain the photographs better."""

import numpy as np
import pytest
import torch
from irgspp.core.stages.second.solver.metal_regions import (
    MAX_METAL_ROUGHNESS,
    MIN_GAIN_PER_SHARE,
    MIN_POSSIBLE_GAIN,
    MIN_REGION_GAIN,
    MIN_SHARP_REGION_GAIN,
    MIN_SMALL_REGION_GAIN,
    MIN_SURE_GAIN,
    NEIGHBOURS,
    SHARP_ROUGHNESS,
    MetalRegion,
    confirm_metal,
    connected_regions,
    grow_metal,
    neighbourhood,
    regions_to_test,
)


def row(count, colour=None):
    """Neighbours and similarities of points in a row, of one colour or with given ones."""
    position = torch.stack([torch.arange(count).float(), torch.zeros(count), torch.zeros(count)], 1)
    colour = torch.full((count, 3), 0.4) if colour is None else colour
    return neighbourhood(position, colour)


def test_a_little_better_fit_is_not_enough():
    assert not grow_metal(torch.full((40,), 0.9 * MIN_SURE_GAIN), *row(40)).any()


def test_metal_fills_its_region_and_stops_at_what_contradicts_it():
    gain = torch.full((60,), 0.5 * MIN_POSSIBLE_GAIN)
    gain[10:13] = 2 * MIN_SURE_GAIN
    gain[40:] = 2 * MIN_POSSIBLE_GAIN
    metal = grow_metal(gain, *row(60))
    assert metal[:34].all() and not metal[40:].any()


def test_metal_stops_at_another_colour():
    colour = torch.tensor([[0.8, 0.5, 0.1]]).repeat(60, 1)
    colour[30:] = torch.tensor([0.1, 0.2, 0.7])
    gain = torch.zeros(60)
    gain[10:13] = 2 * MIN_SURE_GAIN
    metal = grow_metal(gain, *row(60, colour))
    assert metal[:30].all() and not metal[30:].any()


def test_regions_are_connected_by_colour_and_place():
    colour = torch.tensor([[0.8, 0.5, 0.1]]).repeat(60, 1)
    colour[30:] = torch.tensor([0.1, 0.2, 0.7])
    metal = torch.zeros(60, dtype=torch.bool)
    metal[:10] = metal[25:36] = metal[50:52] = True
    found = [torch.nonzero(region)[:, 0].tolist() for region in connected_regions(metal, *row(60, colour))]
    assert found == [list(range(10)), list(range(30, 36)), list(range(25, 30))]  # the largest first; two points are too few
    assert connected_regions(torch.zeros(60, dtype=torch.bool), *row(60)) == []


def test_a_region_that_would_be_rough_metal_is_not_tested():
    roughness = torch.full((60,), 0.9)
    roughness[:10], roughness[30:32] = 0.3, 0.2  # two sharp points do not make the second region sharp
    first, second = masks((0, 10), (30, 40))
    gain = torch.ones(60)
    (found,) = regions_to_test([first, second], roughness, gain)
    assert found.points.equal(first) and found.roughness == pytest.approx(0.3)
    assert len(regions_to_test([first, second], torch.full((60,), MAX_METAL_ROUGHNESS), gain)) == 2


def test_the_points_that_gain_most_tell_how_sharp_a_region_is():
    (region,) = masks((10, 20))
    roughness, gain = torch.full((60,), 0.9), torch.full((60,), 0.1)
    roughness[10:13], gain[10:13] = 0.3, 2.0
    assert len(regions_to_test([region], roughness, gain)) == 1
    gain[10:13] = -5.0  # a loss counts as no gain
    assert not regions_to_test([region], roughness, gain)
    assert not regions_to_test([region], roughness, torch.zeros(60))


NONE = torch.zeros(60, dtype=torch.bool)


def masks(*ranges):
    """Masks of 60 points."""
    return [(torch.arange(60) >= begin) & (torch.arange(60) < end) for begin, end in ranges]


def rough(points):
    """Region whose reflections are not sharp."""
    return MetalRegion(points, SHARP_ROUGHNESS + 0.1)


def test_regions_are_confirmed_by_what_they_gain():
    """A model whose error falls by 1 at true metal, rises by 1 at false metal, and falls elsewhere for a third region."""
    true, false, misleading = masks((0, 20), (20, 30), (30, 35))
    asked = []

    def adapt(metal):
        asked.append(metal)
        errors = torch.full((60,), 2.0) - (metal & true).float() + (metal & false).float() - 0.9 * float((metal & misleading).any())
        return metal, errors

    found, errors, count = confirm_metal([rough(region) for region in (true, false, misleading)], adapt(NONE), adapt)
    assert torch.equal(found, true | misleading) and count == 2
    assert [int(metal.sum()) for metal in asked] == [0, 20, 30, 25]  # each region beside those that are confirmed
    assert torch.equal(errors, adapt(found)[1])


def test_region_must_gain_itself_and_in_all():
    region, rest = masks((0, 20), (20, 60))

    def confirmed(own, other):
        adapt = lambda metal: (metal, 2.0 + metal.any() * (own * region.float() + other * rest.float()))  # noqa: E731
        return confirm_metal([rough(region)], adapt(NONE), adapt)[2]

    assert confirmed(-1, 0.1) == 1
    assert confirmed(-1, 0.6) == 0  # the others lose more
    assert confirmed(0.1, -1) == 0  # only the others gain


@pytest.mark.parametrize(
    ("points", "needed"),
    [(1, MIN_REGION_GAIN), (20, MIN_GAIN_PER_SHARE * 20 / 60), (30, MIN_GAIN_PER_SHARE * 30 / 60), (40, MIN_REGION_GAIN)],
)
def test_large_regions_must_gain_more_but_for_whole_objects(points, needed):
    (region,) = masks((0, points))

    def confirmed(gain):
        """Whether the region is metal if that takes this share off all errors, which are 120."""
        adapt = lambda metal: (metal, 2.0 - 120 * gain / points * metal.any() * region.float())  # noqa: E731
        return confirm_metal([rough(region)], adapt(NONE), adapt)[2]

    assert confirmed(1.1 * needed) == 1
    assert confirmed(0.9 * needed) == 0


@pytest.mark.parametrize(
    ("points", "roughness", "needed"),
    [
        (4, 0.6, MIN_SMALL_REGION_GAIN),
        (8, 0.6, 0.008),
        (20, 0.6, MIN_REGION_GAIN),
        (4, SHARP_ROUGHNESS, MIN_SHARP_REGION_GAIN),
        (20, SHARP_ROUGHNESS, MIN_GAIN_PER_SHARE * 0.02),
        (100, SHARP_ROUGHNESS, MIN_GAIN_PER_SHARE * 0.1),
    ],
)
def test_small_regions_need_their_share_but_a_least_gain_and_sharp_ones_less(points, roughness, needed):
    region = torch.arange(1000) < points
    without = torch.where(region, 100 / points, 900 / (1000 - points))

    def confirmed(gain):
        """Whether the region is metal if that takes this share off all errors, which are 1000."""
        adapt = lambda metal: (metal, without - metal.any() * region * 1000 * gain / points)  # noqa: E731
        return confirm_metal([MetalRegion(region, roughness)], adapt(torch.zeros(1000, dtype=torch.bool)), adapt)[2]

    assert confirmed(1.1 * needed) == 1
    assert confirmed(0.9 * needed) == 0


def test_region_that_cannot_gain_enough_is_not_tested():
    asked = []

    def adapt(metal):
        asked.append(metal)
        return metal, torch.where(torch.arange(60) < 4, 0.01, 2.0)

    assert confirm_metal([rough(points) for points in masks((0, 4))], adapt(NONE), adapt)[2] == 0
    assert len(asked) == 1  # without metal


def test_neighbours_are_near_and_count_by_likeness_of_colour():
    random = np.random.default_rng(0)
    position = torch.from_numpy(random.random((200, 3)).astype(np.float32))
    colour = torch.where(position[:, :1] > 0.5, torch.tensor([0.8, 0.1, 0.1]), torch.tensor([0.1, 0.2, 0.7]))
    index, share = neighbourhood(position, colour)
    distance = torch.cdist(position, position)
    assert torch.equal(index[:, 0], torch.arange(200))
    np.testing.assert_allclose(distance.gather(1, index), distance.sort(1).values[:, :NEIGHBOURS], atol=1e-5)
    np.testing.assert_allclose(share.sum(1), 1, rtol=1e-5)
    other = (position[:, :1] > 0.5) != (position[index][..., 0] > 0.5)
    assert other.any() and share[other].max() < 1e-3
    np.testing.assert_allclose(share[~other.any(1)], 1 / NEIGHBOURS, rtol=1e-5)


def test_few_points_are_all_neighbours():
    index, share = neighbourhood(torch.rand(1, 3), torch.rand(1, 3))
    assert index.shape == share.shape == (1, 1) and share.item() == 1
