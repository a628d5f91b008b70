# SPDX-License-Identifier: GPL-3.0-or-later
"""Smoothness and size of light maps."""

import math

import pytest
import torch
from irgspp.core.stages.common.light_map import LIGHT_SLOPE, light_variation, resampled_light, resized_light

pytestmark = pytest.mark.usefixtures("engine")


@pytest.mark.parametrize("shape", [(2, 4, 3), (8, 16, 3), (5, 1, 3)])
def test_variation_is_that_of_float64_with_its_gradient(shape):
    light = 2 * torch.randn(shape, generator=torch.Generator().manual_seed(0))
    one, exact = light.clone().requires_grad_(), light.double().requires_grad_()
    found, expected = light_variation(one), light_variation(exact)
    (3 * found).backward()
    (3 * expected).backward()
    assert one.grad is not None and exact.grad is not None
    assert found.item() == pytest.approx(expected.item(), rel=1e-5)
    assert (one.grad - exact.grad).norm() <= 1e-5 * exact.grad.norm()


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


def test_a_map_grows_and_never_shrinks():
    assert resized_light(torch.ones(8, 16, 3), 32).shape == (32, 64, 3)
    assert resized_light(torch.ones(8, 16, 3), 4).shape == (8, 16, 3)


@pytest.mark.parametrize("height", [4, 16])
def test_a_resampled_map_has_the_rows_asked_for(height):
    rows = torch.arange(8.0)[:, None, None].expand(8, 16, 3)
    light = resampled_light(rows, height)
    assert light.shape == (height, 2 * height, 3) and light.is_contiguous()
    expected = ((torch.arange(height) + 0.5) * 8 / height - 0.5).clamp(0, 7)
    torch.testing.assert_close(light[:, 0, 0], expected)
