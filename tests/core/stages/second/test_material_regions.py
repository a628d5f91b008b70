# SPDX-License-Identifier: GPL-3.0-or-later
"""Metal grows from clear evidence over points that do not contradict it, and not beyond."""

import numpy as np
import torch
from irgspp.core.stages.second.material_regions import KEEP, NEIGHBOURS, POSSIBLE, SURE, metal_regions, neighbourhood


def row(count, colour=None):
    """Neighbours and similarities of points in a row, of one colour or with given ones."""
    position = torch.stack([torch.arange(count).float(), torch.zeros(count), torch.zeros(count)], 1)
    colour = torch.full((count, 3), 0.4) if colour is None else colour
    return neighbourhood(position, colour)


def test_a_little_better_fit_is_not_enough():
    assert not metal_regions(torch.full((40,), 0.9 * SURE), *row(40)).any()


def test_metal_fills_its_region_and_stops_at_what_contradicts_it():
    gain = torch.full((60,), 0.5 * POSSIBLE)
    gain[10:13] = 2 * SURE
    gain[40:] = 2 * POSSIBLE
    metal = metal_regions(gain, *row(60))
    assert metal[:34].all() and not metal[40:].any()


def test_metal_stops_at_another_colour():
    colour = torch.tensor([[0.8, 0.5, 0.1]]).repeat(60, 1)
    colour[30:] = torch.tensor([0.1, 0.2, 0.7])
    gain = torch.zeros(60)
    gain[10:13] = 2 * SURE
    metal = metal_regions(gain, *row(60, colour))
    assert metal[:30].all() and not metal[30:].any()


def test_found_metal_stays_while_the_light_adapts_and_then_needs_evidence():
    """What the last search found stays with less evidence than it was found with; at the end that must be positive."""
    found = torch.arange(60) < 30
    gain = torch.full((60,), 2 * POSSIBLE)
    assert torch.equal(metal_regions(gain, *row(60), found, 1), found)
    last = len(KEEP)
    assert not metal_regions(gain, *row(60), found, last).any()
    gain[:20] = 0.5 * (KEEP[-1] + SURE)
    kept = metal_regions(gain, *row(60), found, last + 1)
    assert kept[:20].all() and not kept[20:].any()
    assert not metal_regions(gain, *row(60)).any()  # not enough to be found


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
