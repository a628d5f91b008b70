# SPDX-License-Identifier: GPL-3.0-or-later
"""Regions are metal if the photographs are explained better so; those with the colours of such metal need less."""

from types import SimpleNamespace

import pytest
import torch
from irgspp.core.stages.second.solver.metal_confirmation import (
    LIKE_METAL_GAIN,
    MAX_METAL_ROUGHNESS,
    MIN_EVIDENCE,
    MIN_GAIN_PER_SHARE,
    MIN_GAIN_PER_SHARE_BY_SPREAD,
    MIN_REGION_GAIN,
    MIN_SHARP_REGION_GAIN,
    MIN_SMALL_REGION_GAIN,
    MIN_SPREAD,
    MIN_SPREAD_SHARE,
    SHARP_ROUGHNESS,
    Hypothesis,
    MetalRegion,
    confirm_metal,
    measured_regions,
)

NONE = torch.zeros(60, dtype=torch.bool)
ALIKE = torch.full((60,), 0.1)


def masks(*ranges):
    """Masks of 60 points."""
    return [(torch.arange(60) >= begin) & (torch.arange(60) < end) for begin, end in ranges]


def samples(spread):
    """Three views of each of 60 points, whose brightness differs by `spread` (60,) at most."""
    colour = 0.4 + spread[:, None, None] * torch.tensor([0.0, 0.5, 1.0])[None, :, None].expand(60, 3, 3)
    point = torch.arange(60).repeat_interleave(3)
    sums = lambda values: values.reshape(60, 3, -1).sum(1)  # noqa: E731
    return SimpleNamespace(colour=colour.reshape(180, 3), point=point, lengths=torch.full((60,), 3), sums=sums)


def measured(regions, roughness, gain, spread=ALIKE):
    """Regions as they are measured."""
    return measured_regions(regions, samples(spread), roughness, gain)


def rough(points):
    """Region whose reflections are not sharp."""
    return MetalRegion(points, SHARP_ROUGHNESS + 0.1)


def adapted(errors):
    """Function that adapts to metal; `errors` are those that follow from it."""
    return lambda metal: Hypothesis(metal, None, errors(metal))


def unlike(solution, metal):
    """Colours that are those of no metal."""
    return torch.full((len(metal),), -1.0), torch.zeros_like(metal)


def confirmed(regions, adapt, colours=unlike):
    """The points that are metal in the end."""
    return confirm_metal(regions, adapt(torch.zeros_like(regions[0].points)), adapt, colours).metal


def test_a_region_of_rough_metal_is_not_sharp():
    roughness = torch.full((60,), 0.9)
    roughness[:10], roughness[30:32] = 0.3, 0.2  # two sharp points do not make the second region sharp
    regions, gain = masks((0, 10), (30, 40)), torch.ones(60)
    first, second = measured(regions, roughness, gain)
    assert first.is_sharp_enough and not second.is_sharp_enough
    assert first.points.equal(regions[0]) and first.roughness == pytest.approx(0.3)
    assert all(region.is_sharp_enough for region in measured(regions, torch.full((60,), MAX_METAL_ROUGHNESS), gain))
    assert measured([], roughness, gain) == []


def test_regions_are_measured_by_how_much_their_colours_change_from_view_to_view():
    spread = torch.full((60,), 0.02)
    spread[:20], spread[30:33] = 0.1, 0.1  # three points of ten do not make the second region change
    first, second = measured(masks((0, 20), (30, 40)), torch.full((60,), 0.5), torch.ones(60), spread)
    assert 4 < first.spread < 5.5 and second.spread == pytest.approx(1)  # the encoding compresses the change
    (whole,) = measured([~NONE], torch.full((60,), 0.5), torch.ones(60), spread)
    assert whole.spread < MIN_SPREAD  # nothing to compare with


def test_the_points_that_gain_most_tell_how_sharp_a_region_is():
    def sharp_enough():
        return measured(masks((10, 20)), roughness, gain)[0].is_sharp_enough

    roughness, gain = torch.full((60,), 0.9), torch.full((60,), 0.1)
    roughness[10:13], gain[10:13] = 0.3, 2.0
    assert sharp_enough()
    gain[10:13] = -5.0  # a loss counts as no gain
    assert not sharp_enough()
    gain[:] = 0
    assert not sharp_enough()


def test_regions_are_confirmed_by_what_they_gain():
    """A model whose error falls by 1 at true metal, rises by 1 at false metal, and falls elsewhere for a third region."""
    true, false, misleading = masks((0, 20), (20, 30), (30, 35))
    asked = []

    def errors(metal):
        asked.append(metal)
        return torch.full((60,), 2.0) - (metal & true).float() + (metal & false).float() - 0.9 * float((metal & misleading).any())

    adapt = adapted(errors)
    found = confirm_metal([rough(region) for region in (true, false, misleading)], adapt(NONE), adapt, unlike)
    assert torch.equal(found.metal, true | misleading)
    assert [int(metal.sum()) for metal in asked] == [0, 20, 30, 25]  # each region beside those that are confirmed
    assert torch.equal(found.errors, errors(found.metal))


def test_region_must_gain_itself_and_in_all():
    region, rest = masks((0, 20), (20, 60))

    def is_metal(own, other):
        adapt = adapted(lambda metal: 2.0 + metal.any() * (own * region.float() + other * rest.float()))
        return bool(confirmed([rough(region)], adapt).any())

    assert is_metal(-1, 0.1)
    assert not is_metal(-1, 0.6)  # the others lose more
    assert not is_metal(0.1, -1)  # only the others gain


@pytest.mark.parametrize(
    ("points", "needed"),
    [(1, MIN_REGION_GAIN), (20, MIN_GAIN_PER_SHARE * 20 / 60), (30, MIN_GAIN_PER_SHARE * 30 / 60), (40, MIN_REGION_GAIN)],
)
def test_large_regions_must_gain_more_but_for_whole_objects(points, needed):
    (region,) = masks((0, points))

    def is_metal(gain):
        """Whether the region is metal if that takes this share off all errors, which are 120."""
        adapt = adapted(lambda metal: 2.0 - 120 * gain / points * metal.any() * region.float())
        return bool(confirmed([rough(region)], adapt).any())

    assert is_metal(1.1 * needed)
    assert not is_metal(0.9 * needed)


def test_large_regions_whose_colours_change_much_need_less_gain():
    large, small = MIN_SPREAD_SHARE + 0.001, MIN_SPREAD_SHARE - 0.001

    def least_gain(share, spread):
        return MetalRegion(torch.arange(1000) < 1000 * share, SHARP_ROUGHNESS, spread).least_gain

    assert least_gain(large, MIN_SPREAD) == pytest.approx(MIN_GAIN_PER_SHARE_BY_SPREAD * large, rel=1e-3)
    assert least_gain(large, 0.9 * MIN_SPREAD) == pytest.approx(MIN_GAIN_PER_SHARE * large, rel=1e-3)
    assert least_gain(small, MIN_SPREAD) == pytest.approx(MIN_GAIN_PER_SHARE * small, rel=1e-3)


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

    def is_metal(gain):
        """Whether the region is metal if that takes this share off all errors, which are 1000."""
        adapt = adapted(lambda metal: without - metal.any() * region * 1000 * gain / points)
        return bool(confirmed([MetalRegion(region, roughness)], adapt).any())

    assert is_metal(1.1 * needed)
    assert not is_metal(0.9 * needed)


def test_region_that_cannot_gain_enough_is_not_tested():
    asked = []

    def errors(metal):
        asked.append(metal)
        return torch.where(torch.arange(60) < 4, 0.01, 2.0)

    assert not confirmed([rough(points) for points in masks((0, 4))], adapted(errors)).any()
    assert len(asked) == 1  # without metal


def like(*points, dark=NONE, evidence_there=1.0):
    """Colours that are like metal at some points."""
    evidence = torch.full((60,), -1.0)
    for some in points:
        evidence[some] = evidence_there
    return lambda solution, metal: (evidence, dark)


def test_regions_with_the_colours_of_metal_need_less_and_may_be_rough():
    """The second region is too rough, the third gains too little; a fourth with other colours stays."""
    regions = masks((0, 10), (20, 30), (30, 40), (40, 50))
    gains = (10.0, *3 * (1.2 * LIKE_METAL_GAIN * MIN_GAIN_PER_SHARE * 120 * 10 / 60,))
    adapt = adapted(lambda metal: 2.0 - sum(gain / 10 * (metal & region).float() for region, gain in zip(regions, gains, strict=True)))
    sharp, too_rough = SHARP_ROUGHNESS, MAX_METAL_ROUGHNESS + 0.1
    tested = [MetalRegion(region, value) for region, value in zip(regions, (sharp, too_rough, sharp, sharp), strict=True)]
    assert torch.equal(confirmed(tested, adapt), regions[0])
    assert torch.equal(confirmed(tested, adapt, like(*regions[1:3])), regions[0] | regions[1] | regions[2])
    assert torch.equal(confirmed(tested, adapt, like(*regions[1:3], dark=regions[1])), regions[0] | regions[2])
    assert torch.equal(confirmed(tested, adapt, like(*regions[1:3], evidence_there=0.9 * MIN_EVIDENCE)), regions[0])


def test_regions_with_the_colours_of_metal_may_cost_others_less_than_they_gain():
    first, second, rest = masks((0, 10), (20, 30), (30, 60))

    def confirms_second(loss):
        """Whether the second region is metal if it gains 3.6 of 110, which is enough, and the rest loses so much."""
        adapt = adapted(lambda metal: 2.0 - metal * (first + 0.36 * second) + float((metal & second).any()) * loss / 30 * rest)
        regions = [MetalRegion(region, SHARP_ROUGHNESS) for region in (first, second)]
        return bool((confirmed(regions, adapt, like(second)) & second).any())

    assert confirms_second(3.5)
    assert not confirms_second(3.7)


def test_colours_tell_nothing_without_other_metal():
    (region,) = masks((0, 10))
    adapt = adapted(lambda metal: 2.0 - 1.5 * (metal & region).float())
    too_rough = MetalRegion(region, MAX_METAL_ROUGHNESS + 0.1)
    assert not confirmed([too_rough], adapt, like(region)).any()
