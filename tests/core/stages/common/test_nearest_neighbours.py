# SPDX-License-Identifier: GPL-3.0-or-later
"""Nearest neighbours among points."""

import pytest
import torch
from irgspp.core.stages.common.nearest_neighbours import nearest_neighbours


@pytest.mark.parametrize("count", [1, 4, 50])
def test_neighbours_are_those_of_a_plain_search(count):
    generator = torch.Generator().manual_seed(0)
    points, queries = torch.randn(20, 3, generator=generator), torch.randn(7, 3, generator=generator)
    expected = torch.cdist(queries, points).argsort(1)[:, :count]
    found = nearest_neighbours(points.requires_grad_(), queries, count)
    assert found.dtype == torch.int64 and found.shape == (7, min(count, 20))
    assert torch.equal(found, expected)


def test_a_point_is_its_own_first_neighbour():
    points = torch.randn(3, 20, generator=torch.Generator().manual_seed(1)).T
    assert torch.equal(nearest_neighbours(points, points, 3)[:, 0], torch.arange(20))
