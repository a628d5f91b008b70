# SPDX-License-Identifier: GPL-3.0-or-later
"""Fresnel weight of the kernels: that of the BRDF, and its derivative."""

import pytest
import torch
from irgspp.core.kernels.cpu.fresnel import fresnel_slope, fresnel_weight
from irgspp.core.shading.brdf import fresnel_weight as defined


@pytest.mark.parametrize("x", [0.0, 0.01, 0.3, 0.5, 0.75, 0.9, 1.0])
def test_weight_and_slope_are_those_of_the_brdf(x):
    cosine = torch.tensor(1 - x, dtype=torch.float64, requires_grad=True)
    weight = defined(cosine)
    weight.backward()
    assert fresnel_weight(x) == pytest.approx(weight.item(), abs=1e-12)
    assert fresnel_slope(x) == pytest.approx(-cosine.grad.item(), abs=1e-12)
