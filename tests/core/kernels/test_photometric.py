# SPDX-License-Identifier: GPL-3.0-or-later
"""Fused loss L1 + D-SSIM against torch's convolutions in float64."""

import pytest
import torch
from irgspp.core.kernels.photometric import photometric_loss
from irgspp.core.kernels.reference.photometric import photometric_reference

pytestmark = pytest.mark.usefixtures("engine")


@pytest.mark.parametrize("shape", [(3, 40, 56), (3, 13, 9), (3, 5, 33)])
@pytest.mark.parametrize("ssim_weight", [0.0, 0.2, 1.0])
def test_value_and_gradient(shape, ssim_weight):
    g = torch.Generator().manual_seed(sum(shape))
    x, y = torch.rand(shape, generator=g), torch.rand(shape, generator=g)
    fast, slow = x.clone().requires_grad_(), x.double().requires_grad_()
    a, b = photometric_loss(fast, y, ssim_weight), photometric_reference(slow, y.double(), ssim_weight)
    a.backward()
    b.backward()
    assert a.item() == pytest.approx(b.item(), abs=2e-6)
    assert (fast.grad - slow.grad).norm() <= 2e-5 * slow.grad.norm()


def test_equal_images_cost_nothing():
    x = torch.rand(3, 20, 20)
    assert photometric_loss(x, x.clone()).item() == pytest.approx(0, abs=1e-6)
