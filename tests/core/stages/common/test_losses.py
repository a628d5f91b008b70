# SPDX-License-Identifier: GPL-3.0-or-later
"""Rays of a camera, and the smoothness of a light map."""

import math

import numpy as np
import pytest
import torch
from irgspp.core.stages.common.losses import LIGHT_SLOPE, camera_rays, light_variation


@pytest.fixture(scope="module")
def camera(camera_ring):
    return camera_ring(5, size=32)[2]


@pytest.fixture(scope="module")
def rotation(camera):
    return torch.as_tensor(camera.world_to_cv[:3, :3].copy())


def test_rays_are_the_cameras(camera, rotation):
    world = torch.einsum("ij,ihw->hwj", rotation.float(), camera_rays(camera))
    assert np.allclose(world.numpy(), camera.rays(), atol=1e-5)


def test_variation_wraps_around_the_seam():
    light = torch.zeros(4, 8, 3)
    light[:, 0] = 1e-3
    assert light_variation(light) == pytest.approx(1e-6 * 2 / 8, rel=1e-4)  # up and down again, once across the seam
    assert light_variation(torch.ones(4, 8, 3)) == 0


def test_an_edge_counts_less_than_its_square():
    edge = LIGHT_SLOPE * math.pi / 4  # between texels of a map of four rows
    light = torch.zeros(4, 8, 3)
    light[:, :4] = 10 * edge
    assert light_variation(light) == pytest.approx(edge**2 * math.log(101) * 2 / 8, rel=1e-5)
