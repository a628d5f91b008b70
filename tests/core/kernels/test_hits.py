# SPDX-License-Identifier: GPL-3.0-or-later
"""Hit lists: which surfels rays hit, in which order, and sums over hits, against exact values."""

import math

import numpy as np
import pytest
import torch
from irgspp.core.kernels.constants import TRANSMITTANCE_MIN
from irgspp.core.kernels.cpu.bvh import SurfelTree
from irgspp.core.kernels.cpu.trace import NEAREST
from irgspp.core.kernels.trace import EXTRA, blend, build_tree, hit_lists, trace, transmittance
from surfel_clouds import UP, cloud, rays, stack

pytestmark = pytest.mark.usefixtures("engine")


@pytest.mark.parametrize("opacity", [0.01, 0.1, 0.5])
@pytest.mark.parametrize("n", [NEAREST - 1, NEAREST, NEAREST + 1, 2 * NEAREST, 3 * NEAREST + 5])
def test_stacked_surfels_are_hit_once_each_and_in_order(n, opacity):
    parameters, order = stack(n, opacity)
    lists = hit_lists(build_tree(*parameters[:4]), *UP)
    seen = min(n, math.ceil(math.log(TRANSMITTANCE_MIN) / math.log(1 - opacity)))
    assert len(lists.index) == seen
    assert order[lists.index].tolist() == list(range(seen))
    assert lists.distance.tolist() == [i + 1 for i in range(seen)]
    weight = opacity * (1 - opacity) ** np.arange(seen)
    opaque = (1 - opacity) ** seen <= TRANSMITTANCE_MIN
    assert np.allclose(lists.weight, weight / weight.sum() if opaque else weight, rtol=1e-4)


@pytest.mark.parametrize("n", [20, 3 * NEAREST])
def test_surfels_at_equal_distance_are_ordered_by_index(n):
    parameters, _ = stack(n, 0.02)
    parameters[0][2] = torch.where(torch.arange(n) % 2 == 0, 2.0, 1.0)
    lists = hit_lists(build_tree(*parameters[:4]), *UP)
    expected = [*range(1, n, 2), *range(0, n, 2)]
    assert lists.index.tolist() == expected[: len(lists.index)]
    assert len(lists.index) == min(n, math.ceil(math.log(TRANSMITTANCE_MIN) / math.log(0.98)))


def test_a_deep_tree():
    n = 90
    parameters, order = stack(n, 0.03)
    parameters[0][2] = 1.4 ** (order + 1.0)  # each binned split separates only a few
    parameters[2][:] = (0.01 * parameters[0][2]).log()
    tree = build_tree(*parameters[:4])
    assert not isinstance(tree, SurfelTree) or tree.depth > 2  # 90 surfels evenly spread need 2
    lists = hit_lists(tree, *UP)
    assert order[lists.index].tolist() == list(range(n))
    assert transmittance(tree, *UP)[0].item() == pytest.approx(0.97**n, rel=1e-4)


def test_an_origin_inside_a_surfels_bound_sees_it():
    parameters, _ = stack(1, 0.5)
    parameters[1][:, 0] = torch.tensor([math.cos(0.35), math.sin(0.35), 0, 0])  # tilted: its box is thick
    tree = build_tree(*parameters[:4])
    for z, distance in [(0.999, 0.001), (0.5, 0.5), (1.001, None)]:
        lists = hit_lists(tree, torch.tensor([[0, 0, z]]), UP[1])
        assert lists.distance.tolist() == ([] if distance is None else [pytest.approx(distance, rel=1e-3)])


def test_grazed_surfels_are_missed():
    parameters, _ = stack(1, 0.9)
    tree = build_tree(*parameters[:4])
    for slope, hits in [(5e-5, 0), (5e-3, 1)]:
        direction = torch.tensor([[math.sqrt(1 - slope**2), 0, slope]])
        lists = hit_lists(tree, torch.tensor([[-1.0, 0, 1 - slope]]), direction)
        assert len(lists.index) == hits


def test_hit_lists_reproduce_the_trace():
    parameters, (origin, direction) = cloud(400, 2, opacity=1.0), rays(500, 3)
    tree = build_tree(*parameters[:4])
    lists, out = hit_lists(tree, origin, direction), trace(*parameters, origin, direction, tree)
    ray = np.repeat(np.arange(lists.rays), np.diff(lists.start))
    assert np.allclose(np.bincount(ray, lists.weight, lists.rays), out[:, -1], atol=1e-5)
    assert np.allclose(np.bincount(ray, lists.weight * lists.distance, lists.rays), out[:, -2], atol=1e-5)
    assert torch.allclose(blend(lists, parameters[5]), out[:, EXTRA:-2], atol=1e-6)
    rising = np.diff(lists.distance) >= 0
    assert rising[np.diff(ray) == 0].all()


@pytest.mark.parametrize("channels", [1, 8, 11])
def test_blend_is_a_sparse_matrix(channels):
    parameters, (origin, direction) = cloud(200, 2), rays(150, 3)
    lists = hit_lists(build_tree(*parameters[:4]), origin, direction)
    dense = torch.zeros(150, 200, dtype=torch.float64)
    ray = torch.from_numpy(np.repeat(np.arange(150), np.diff(lists.start)))
    dense[ray, torch.as_tensor(lists.index).long()] = torch.as_tensor(lists.weight).double()
    g = torch.Generator().manual_seed(0)
    values = torch.randn(channels, 200, generator=g).requires_grad_()
    rows = torch.randint(150, (60,), generator=g)  # some twice
    out = blend(lists, values, rows)
    upstream = torch.randn(out.shape, generator=g)
    out.backward(upstream)
    assert torch.allclose(out.double(), dense[rows] @ values.detach().double().T, atol=1e-5)
    assert values.grad is not None
    assert torch.allclose(values.grad.double(), (dense[rows].T @ upstream.double()).T, atol=1e-5)
    assert torch.equal(blend(lists, values.detach()), blend(lists, values.detach(), torch.arange(150)))
