# SPDX-License-Identifier: GPL-3.0-or-later
"""Surfels turned towards the surface."""

import numpy as np
import pytest
import torch
from irgspp.core.kernels.reference.rotations import rotation_matrix
from irgspp.core.scene.gaussians import Gaussians
from irgspp.core.scene.surface import Surface
from irgspp.core.stages.second.normals.normal_alignment import align_normals, follow_normals, product, shortest_turn


def unit(*shape: int) -> torch.Tensor:
    vectors = torch.randn(*shape, generator=torch.Generator().manual_seed(sum(shape)), dtype=torch.float64)
    return torch.nn.functional.normalize(vectors, dim=0)


def test_the_product_turns_by_one_after_the_other():
    left, right = unit(4, 50), unit(4, 51)[:, :50]
    both = torch.einsum("ijn,jkn->ikn", rotation_matrix(left), rotation_matrix(right))
    assert torch.allclose(rotation_matrix(product(left, right)), both, atol=1e-12)


def test_the_shortest_turn_takes_one_vector_to_the_other():
    source, goal = unit(3, 40), unit(3, 41)[:, :40]
    turn = rotation_matrix(shortest_turn(source, goal))
    assert torch.allclose(torch.einsum("ijn,jn->in", turn, source), goal, atol=1e-9)
    axis = torch.linalg.cross(source, goal, dim=0)
    assert torch.allclose(torch.einsum("ijn,jn->in", turn, axis), axis, atol=1e-9)  # about the axis perpendicular to both


@pytest.mark.parametrize("fraction", [0.0, 0.5, 1.0])
def test_surfels_go_that_fraction_of_the_way_on_whichever_side_they_are(fraction):
    grid = np.stack([*np.meshgrid(np.linspace(-1, 1, 9), np.linspace(-1, 1, 9)), np.zeros((9, 9))], -1).reshape(-1, 3)
    surface = Surface(grid, np.tile([0.0, 0.0, 1.0], (81, 1)), np.array([[0, 1, 2]]), 0.1)
    tilt = torch.tensor([0.0, 10.0, 170.0, 60.0]).deg2rad()  # from +Z about X: beside, behind, and an edge
    quaternion = torch.stack([(tilt / 2).cos(), (tilt / 2).sin(), torch.zeros(4), torch.zeros(4)])
    surfels = Gaussians(torch.zeros(3, 4), quaternion, torch.zeros(2, 4), torch.zeros(4), torch.zeros(16, 3, 4), torch.zeros(5, 4))
    angle = align_normals(surfels, surface, fraction).normals()[2].acos().rad2deg()
    assert torch.allclose(angle, torch.tensor([0.0, 10 * (1 - fraction), 180 - 10 * (1 - fraction), 60.0]), atol=0.1)


def test_surfels_turn_as_the_surface_did_on_whichever_side_they_are():
    grid = np.stack([*np.meshgrid(np.linspace(-1, 1, 9), np.linspace(-1, 1, 9)), np.zeros((9, 9))], -1).reshape(-1, 3)
    before = Surface(grid, np.tile([0.0, 0.0, 1.0], (81, 1)), np.array([[0, 1, 2]]), 0.1)
    after = Surface(grid, np.tile([0.0, -np.sin(0.1), np.cos(0.1)], (81, 1)), before.faces, 0.1)
    tilt = torch.tensor([0.0, 10.0, 180.0, 60.0]).deg2rad()  # from +Z about X
    quaternion = torch.stack([(tilt / 2).cos(), (tilt / 2).sin(), torch.zeros(4), torch.zeros(4)])
    surfels = Gaussians(torch.zeros(3, 4), quaternion, torch.zeros(2, 4), torch.zeros(4), torch.zeros(16, 3, 4), torch.zeros(5, 4))
    _, y, z = follow_normals(surfels, before, after, 1.0).normals()
    turned = torch.remainder(torch.atan2(-y, z) - tilt, 2 * np.pi)
    assert torch.allclose(turned, torch.tensor([0.1, 0.1, 0.1, 0.0]), atol=3e-3)
