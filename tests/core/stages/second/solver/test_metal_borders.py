# SPDX-License-Identifier: GPL-3.0-or-later
"""Borders of metal among surfels of a plane, by errors, colours and the solver's points around them."""

import pytest
import torch
from irgspp.core.stages.second.solver.metal_borders import AlbedoFit, drawn_metal, nearby_points

GOLD, PAINT = torch.tensor([1.0, 0.77, 0.34]), torch.tensor([0.2, 0.3, 0.6])


def on_grid(step):
    """Points (P, 3) of a plane, 20 on each side, or further ones within it."""
    x = torch.arange(0.0, 20.0 - step / 2, step)
    return torch.stack([*torch.meshgrid(x, x, indexing="ij"), torch.zeros(len(x), len(x))], -1).view(-1, 3)


def drawn(true, known, noise=0.0, metals=GOLD):
    """Draw the metal of surfels four times as dense as the points; `true` and `known` tell of positions whether they are metal.

    The surfels have the albedo `metals` (3,) or (N, 3) where they are metal.
    """
    points, surfels = on_grid(1.0), on_grid(0.25) + 0.02
    metal, generator = true(surfels), torch.Generator().manual_seed(0)
    nearby = nearby_points(points, torch.full((len(points),), 0.4), known(points).float(), surfels)
    own, other = (1 + noise * torch.rand(len(surfels), generator=generator) for _ in range(2))
    dielectric, conductor = torch.where(metal, 3 * other, own), torch.where(metal, own, 3 * other)
    colour = torch.where(metal[:, None], metals, PAINT)
    fits = (AlbedoFit(colour, torch.ones_like(colour), error) for error in (dielectric, conductor))
    return drawn_metal(surfels, 0.5 * colour, nearby, *fits), metal


@pytest.mark.parametrize("noise", [0.0, 2.0])
def test_borders_are_finer_than_the_points(noise):
    found, metal = drawn(lambda p: p[:, 0] > 10.3, lambda p: p[:, 0] > 9.6, noise)
    assert (found != metal).float().mean() < (0.001 if noise == 0 else 0.01)


def test_a_band_as_narrow_as_the_points_are_apart_stays():
    found, metal = drawn(lambda p: (p[:, 0] - 10).abs() < 0.6, lambda p: (p[:, 0] - 10).abs() < 0.6)
    assert torch.equal(found, metal) and 0 < metal.float().mean() < 0.1


def test_surfels_that_would_be_dark_metal_are_none():
    at = on_grid(0.25)[:, 0] + 0.02
    rubber = (at > 10.3) & (at < 13.3)
    black = torch.where(rubber[:, None], torch.full((3,), 0.11), GOLD)
    among_black, among_gold = (drawn(lambda p: p[:, 0] > 10.3, lambda p: p[:, 0] > 13.6, metals=metals)[0] for metals in (black, GOLD))
    assert among_gold[(at > 12.5) & rubber].all()  # as metal they fit better
    assert not among_black[(at < 13.0) & rubber].any()  # neighbours' albedos are averaged
    assert among_black[at > 14.0].all()


def test_a_single_point_does_not_make_metal_where_nothing_else_speaks_for_it():
    found, _ = drawn(lambda p: p[:, 0] > 100, lambda p: (p - torch.tensor([10.0, 10.0, 0.0])).norm(dim=1) < 0.1)
    assert not found.any()


@pytest.mark.parametrize("metallic", [0.0, 1.0])
def test_where_all_points_agree_they_decide(metallic):
    points, surfels = on_grid(1.0), on_grid(0.5)
    nearby = nearby_points(points, torch.full((len(points),), 0.4), torch.full((len(points),), metallic), surfels)
    nothing = torch.zeros(len(surfels), 3)
    worse = AlbedoFit(nothing, nothing, nothing[:, 0])
    assert (drawn_metal(surfels, nothing, nearby, worse, worse) == bool(metallic)).all()


def test_roughness_does_not_mix_across_an_edge_of_metal():
    points = on_grid(1.0)
    metallic = (points[:, 0] > 9.5).float()
    nearby = nearby_points(points, torch.where(metallic > 0, 0.2, 0.8), metallic, on_grid(0.5) + 0.1)
    dielectric, metal = nearby.roughness
    torch.testing.assert_close(dielectric[nearby.share < 1], torch.full_like(dielectric[nearby.share < 1], 0.8))
    torch.testing.assert_close(metal[nearby.share > 0], torch.full_like(metal[nearby.share > 0], 0.2))
    at = on_grid(0.5)[:, 0] + 0.1
    assert (nearby.majority[at > 10.0] > 0.5).all() and (nearby.majority[at < 9.0] < 0.5).all()


def test_few_points_suffice():
    nearby = nearby_points(torch.eye(3), torch.tensor([0.2, 0.4, 0.9]), torch.tensor([1.0, 1.0, 0.0]), torch.rand(5, 3))
    torch.testing.assert_close(nearby.roughness, torch.tensor([[0.9], [0.3]]).expand(2, 5))
    torch.testing.assert_close(nearby.majority, torch.full((5,), 2 / 3))
