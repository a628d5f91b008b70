# SPDX-License-Identifier: GPL-3.0-or-later
"""Spherical harmonics: an orthonormal basis, and the radiance that a ray at a surfel sees."""

import math

import numpy as np
import pytest
import torch
from irgspp.core.kernels.cpu.bvh import SurfelTree
from irgspp.core.kernels.trace import COLOUR, trace
from irgspp.core.scene.spherical_harmonics import sh_basis, sh_radiance
from irgspp.core.shading.environment_lookup import texel_directions


@pytest.mark.parametrize("degree", [0, 1, 2, 3])
def test_the_basis_is_orthonormal_over_the_sphere(degree):
    height, width = 128, 256
    direction = texel_directions(height, width).double().view(-1, 3)
    area = torch.sin((torch.arange(height, dtype=torch.float64) + 0.5) * math.pi / height) * (math.pi / height) * (2 * math.pi / width)
    basis = sh_basis(direction.T, degree)
    assert basis.shape == ((degree + 1) ** 2, height * width)
    products = basis * area.repeat_interleave(width) @ basis.T
    torch.testing.assert_close(products, torch.eye(len(basis), dtype=torch.float64), atol=1e-3, rtol=0)


def test_sh_are_what_a_ray_at_the_surfel_sees(some_gaussians):
    g = some_gaussians(30, 0)
    index = torch.tensor([3, 3, 29, 0, 17, 8])
    view = torch.nn.functional.normalize(torch.randn(6, 3, generator=torch.Generator().manual_seed(1)), dim=1)
    actual = sh_radiance(g.sh[:, :, index], view.T).T
    assert (actual >= 0).all() and (actual == 0).any() and (actual > 0).any()
    for k, i in enumerate(index):
        one = g.select(i[None])
        parameters = (one.position, one.quaternion, one.log_scale, torch.full((1,), 3.0))
        origin = one.position.T + 5 * view[k]
        sums = trace(*parameters, one.sh, torch.zeros(0, 1), origin, -view[k : k + 1], SurfelTree.build(*parameters))[0]
        np.testing.assert_allclose(actual[k], sums[COLOUR] / sums[-1], atol=1e-5)
