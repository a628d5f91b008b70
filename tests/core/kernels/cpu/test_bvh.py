# SPDX-License-Identifier: GPL-3.0-or-later
"""Bounding volume hierarchy over surfels: every surfel is kept, every box contains its surfels."""

import math

import numpy as np
import pytest
import torch
from irgspp.core.kernels.constants import ALPHA_MIN, CUT
from irgspp.core.kernels.cpu.bvh import LEAF, NODE, SurfelTree
from irgspp.core.kernels.reference.rotations import rotation_matrix


def surfels(n, seed=0, size=0.1):
    g = torch.Generator().manual_seed(seed)
    random = lambda *shape: torch.randn(*shape, generator=g)  # noqa: E731
    return [random(3, n), random(4, n), math.log(size) + 0.5 * random(2, n), 1.5 * random(n)]


def boxes(tree):
    """Return the boxes of all children, (nodes, 8, low/high, 3)."""
    return tree.node.reshape(-1, 2, 3, 8).transpose(0, 3, 1, 2)


def rims(parameters):
    """Return points (N, 64, 3) around each surfel, where its alpha is ALPHA_MIN, in float64."""
    position, quaternion, log_scale, opacity = (p.double() for p in parameters)
    radius = torch.sqrt(2 * torch.log(opacity.sigmoid() / ALPHA_MIN))
    axes, scale = rotation_matrix(quaternion), log_scale.exp() * radius
    angle = torch.linspace(0, 2 * math.pi, 64, dtype=torch.float64)
    ring = scale[0] * axes[:, 0] * angle.cos()[:, None, None] + scale[1] * axes[:, 1] * angle.sin()[:, None, None]
    return (position + ring).permute(2, 0, 1).numpy()


def enclosed(tree, node, rim):
    """Check every box below `node` against the rims of the surfels; return the Gaussians found there."""
    found = []
    for lane, child in enumerate(tree.child[node]):
        low, high = boxes(tree)[node, lane]
        if child == node:
            assert (low > high).all()  # a place without a child cannot be hit
            continue
        if child < 0:
            held = tree.index[~child * 8 : ~child * 8 + 8]
            members = held[held >= 0].tolist()
        else:
            assert child > node
            members = enclosed(tree, child, rim)
        assert members
        points = rim[members]
        assert (points >= low).all() and (points <= high).all()
        found += members
    return found


@pytest.mark.parametrize("n", [1, 7, 8, 9, 64, 65, 1000])
def test_boxes_contain_every_surfel_once(n):
    parameters = surfels(n, n)
    parameters[3] = parameters[3].abs()
    tree = SurfelTree.build(*parameters)
    assert sorted(enclosed(tree, 0, rims(parameters))) == list(range(n))


def test_boxes_are_tight():
    parameters = surfels(50, 2)
    parameters[3] = parameters[3].abs()
    tree = SurfelTree.build(*parameters)
    rim = rims(parameters)
    low, high = boxes(tree)[0, :, 0].min(0), boxes(tree)[0, :, 1].max(0)
    assert np.allclose(low, rim.min((0, 1)), atol=5e-3) and np.allclose(high, rim.max((0, 1)), atol=5e-3)


def test_leaves_are_mostly_full_and_the_tree_is_shallow():
    tree = SurfelTree.build(*surfels(5000))
    assert (tree.index >= 0).mean() > 0.7
    assert tree.depth <= 6


@pytest.mark.parametrize("n", [9, 500])
def test_surfels_all_in_one_place_still_split(n):
    parameters = surfels(n)
    parameters[0][:] = 0.25
    tree = SurfelTree.build(*parameters)
    assert np.unique(tree.index[tree.index >= 0]).size == (tree.record[:, CUT] >= 0).sum()
    assert tree.depth <= 5


def spoil(parameters, g, fault):
    position, quaternion, log_scale, opacity = parameters
    if fault == "invisible":
        opacity[g] = -20.0
    elif fault == "a point":
        log_scale[1, g] = -math.inf
    elif fault == "endless":
        log_scale[0, g] = 200.0
    else:
        {"position": position[1], "quaternion": quaternion[2], "log_scale": log_scale[0], "opacity": opacity}[fault][g] = math.nan


@pytest.mark.parametrize("fault", ["invisible", "a point", "endless", "position", "quaternion", "log_scale", "opacity"])
def test_invisible_surfels_are_left_out(fault):
    parameters = surfels(40)
    parameters[3] = parameters[3].abs()
    spoil(parameters, 17, fault)
    tree = SurfelTree.build(*parameters)
    assert sorted(tree.index[tree.index >= 0]) == [i for i in range(40) if i != 17]
    assert np.isfinite(tree.leaf).all()
    assert tree.matches(*parameters)


def test_opacity_of_exactly_alpha_min_is_left_out():
    parameters = surfels(8)
    parameters[3][:] = math.log(ALPHA_MIN / (1 - ALPHA_MIN)) - 1e-5
    assert SurfelTree.build(*parameters).depth == 0
    parameters[3] += 1e-3
    assert SurfelTree.build(*parameters).depth == 1


def test_refit_contains_moved_surfels():
    parameters = surfels(300, 1)
    parameters[3] = parameters[3].abs()
    tree = SurfelTree.build(*parameters)
    moved = [p + 0.2 * torch.randn(p.shape, generator=torch.Generator().manual_seed(4)) for p in parameters]
    moved[3] = moved[3].abs()
    child = tree.child.copy()
    assert not tree.matches(*moved)
    tree.refit(*moved)
    assert tree.matches(*moved) and np.array_equal(child, tree.child)
    assert sorted(enclosed(tree, 0, rims(moved))) == list(range(300))


def test_refit_with_the_same_numbers_changes_nothing():
    parameters = surfels(100)
    tree, other = SurfelTree.build(*parameters), SurfelTree.build(*parameters)
    tree.refit(*parameters)
    for name in ("record", "child", "node", "index", "leaf"):
        assert np.array_equal(getattr(tree, name), getattr(other, name))


def test_refit_adds_surfels_that_became_visible():
    parameters = surfels(100)
    parameters[3][:50] = -20.0
    tree = SurfelTree.build(*parameters)
    shown = [*parameters[:3], torch.ones(100)]
    tree.refit(*shown)
    assert sorted(tree.index[tree.index >= 0]) == list(range(100))


def test_refit_empties_boxes_of_vanished_surfels():
    parameters = surfels(20)
    parameters[3] = parameters[3].abs()
    tree = SurfelTree.build(*parameters)
    tree.refit(*parameters[:3], torch.full((20,), -20.0))
    assert (tree.record[:, CUT] < 0).all()
    assert (boxes(tree)[:, :, 0] > boxes(tree)[:, :, 1]).all()


def test_no_surfels_make_an_empty_tree():
    tree = SurfelTree.build(torch.empty(3, 0), torch.empty(4, 0), torch.empty(2, 0), torch.empty(0))
    assert tree.depth == 0 and not len(tree.index)
    assert len(tree.node) == len(tree.child) * NODE and len(tree.leaf) == len(tree.index) // 8 * LEAF
