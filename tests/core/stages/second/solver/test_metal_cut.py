# SPDX-License-Identifier: GPL-3.0-or-later
"""The borders of metal are the least cut: compared with the best of all labellings of a few points."""

from itertools import product

import numpy as np
import pytest
import torch
from irgspp.core.stages.second.solver.metal_cut import MAX_RINGS, METAL_PRIOR, NEIGHBOUR_COUPLING, cut_metal
from irgspp.core.stages.second.solver.metal_regions import neighbourhood


def row(count, colour=None):
    """Neighbours and similarities of points in a row, of one colour or with given ones."""
    position = torch.stack([torch.arange(count).float(), torch.zeros(count), torch.zeros(count)], 1)
    return neighbourhood(position, torch.full((count, 3), 0.4) if colour is None else colour)


def energy(metal, evidence, neighbours, similarity):
    """Evidence of the metal points less the similarity across borders, of a labelling (P,) bool."""
    across = metal[:, None] != metal[neighbours]
    return float(((evidence + METAL_PRIOR) * metal).sum() - 0.5 * NEIGHBOUR_COUPLING * (similarity * across).sum())


@pytest.mark.parametrize("seed", range(5))
def test_the_cut_is_the_best_labelling(seed):
    generator = torch.Generator().manual_seed(seed)
    evidence = torch.randn(11, generator=generator, dtype=torch.float64)
    neighbours, similarity = neighbourhood(torch.rand(11, 3, generator=generator), torch.rand(11, 3, generator=generator))
    neighbours, similarity = neighbours[:, :5], similarity[:, :5].double()
    labels = [torch.tensor(label) for label in product((False, True), repeat=11)]
    found = cut_metal(evidence, torch.ones(11, dtype=torch.bool), neighbours, similarity)
    energies = [energy(label, evidence, neighbours, similarity) for label in labels]
    assert energy(found, evidence, neighbours, similarity) == pytest.approx(max(energies), abs=5e-3)
    assert 0 < int(found.sum()) < 11


def test_doubtful_points_belong_to_what_surrounds_them():
    evidence = torch.full((80,), -0.2)
    evidence[:40] = 0.15
    evidence[18:21] = -0.2  # wrong normals within the metal
    metal = torch.zeros(80, dtype=torch.bool)
    metal[:50] = True  # it has leaked beyond 40
    found = cut_metal(evidence, metal, *row(80))
    np.testing.assert_array_equal(found, torch.arange(80) < 40)


def test_borders_follow_colour():
    colour = torch.full((60, 3), 0.5)
    colour[30:] = torch.tensor([0.1, 0.2, 0.7])
    evidence = torch.where(torch.arange(60) < 24, 0.3, -0.15)  # 24 to 30 are doubtful, but have the metal's colour
    found = cut_metal(evidence, torch.arange(60) < 40, *row(60, colour))
    np.testing.assert_array_equal(found, torch.arange(60) < 30)


def test_metal_returns_near_metal_alone():
    neighbours, similarity = row(200)
    reach = MAX_RINGS * int((neighbours - torch.arange(200)[:, None]).abs()[50:150].max())
    found = cut_metal(torch.ones(200), torch.arange(200) < 100, neighbours, similarity)
    np.testing.assert_array_equal(found, torch.arange(200) < 100 + reach)


def test_no_metal_stays_none_and_all_stays_all():
    everything = torch.ones(60, dtype=torch.bool)
    assert cut_metal(torch.full((60,), -0.5 * METAL_PRIOR), everything, *row(60)).all()
    assert not cut_metal(torch.full((60,), -2 * METAL_PRIOR), everything, *row(60)).any()
