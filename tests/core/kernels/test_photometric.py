# SPDX-License-Identifier: GPL-3.0-or-later
"""Fused loss L1 + D-SSIM against torch's convolutions in float64."""

import pytest
import torch
from irgspp.core.kernels.constants import SSIM_TAPS
from irgspp.core.kernels.photometric import photometric_loss

pytestmark = pytest.mark.usefixtures("engine")


def reference(x, y, ssim_weight):
    window = torch.as_tensor(SSIM_TAPS).double()
    window = (window[:, None] * window[None])[None, None].repeat(3, 1, 1, 1)
    blur = lambda t: torch.nn.functional.conv2d(t[None], window, padding=5, groups=3)[0]  # noqa: E731
    mx, my = blur(x), blur(y)
    vx, vy, vxy = blur(x * x) - mx**2, blur(y * y) - my**2, blur(x * y) - mx * my
    ssim = (2 * mx * my + 1e-4) * (2 * vxy + 9e-4) / ((mx**2 + my**2 + 1e-4) * (vx + vy + 9e-4))
    return (1 - ssim_weight) * (x - y).abs().mean() + ssim_weight * (1 - ssim.mean())


@pytest.mark.parametrize("shape", [(3, 40, 56), (3, 13, 9), (3, 5, 33)])
@pytest.mark.parametrize("ssim_weight", [0.0, 0.2, 1.0])
def test_value_and_gradient(shape, ssim_weight):
    g = torch.Generator().manual_seed(sum(shape))
    x, y = torch.rand(shape, generator=g), torch.rand(shape, generator=g)
    fast, slow = x.clone().requires_grad_(), x.double().requires_grad_()
    a, b = photometric_loss(fast, y, ssim_weight), reference(slow, y.double(), ssim_weight)
    a.backward()
    b.backward()
    assert a.item() == pytest.approx(b.item(), abs=2e-6)
    assert (fast.grad - slow.grad).norm() <= 2e-5 * slow.grad.norm()


def test_equal_images_cost_nothing():
    x = torch.rand(3, 20, 20)
    assert photometric_loss(x, x.clone()).item() == pytest.approx(0, abs=1e-6)
