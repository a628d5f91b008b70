# SPDX-License-Identifier: GPL-3.0-or-later
"""Metal grows from clear evidence over points that do not contradict it, into regions of one colour."""

import numpy as np
import torch
from irgspp.core.stages.second.solver.metal_regions import (
    MIN_POSSIBLE_GAIN,
    MIN_SURE_GAIN,
    NEIGHBOURS,
    connected_regions,
    grow_metal,
    neighbourhood,
    often_seen,
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


def test_regions_that_few_views_show_are_dropped():
    metal, views = torch.zeros(60, dtype=torch.bool), torch.full((60,), 8)
    metal[:10] = metal[30:40] = metal[59] = True
    views[30:40], views[:3], views[59] = 4, 3, 4  # all of a region, some of another, and a point alone
    assert torch.nonzero(often_seen(metal, views, *row(60)))[:, 0].tolist() == list(range(10))
    assert torch.equal(often_seen(metal, views.clamp(max=4), *row(60)), metal)  # where no point has more views, these are enough


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
