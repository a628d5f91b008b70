# SPDX-License-Identifier: GPL-3.0-or-later
"""The estimate of reflected light by the CPU's kernel against its definition in PyTorch operations."""

import numpy as np
import pytest
import torch
from irgspp.core.relight.estimate import MAX_CORRECTION, Reflectance, estimate_reference, estimate_reflected_light
from irgspp.core.relight.indirect_light import SUMS
from irgspp.core.relight.prepared_light import prepare_light

PARTS = ("diffuse", "specular", "diffuse_split", "specular_split")


@pytest.fixture
def given():
    """Sums of 500 points, some of which no light reaches, their reflectance, and a light."""
    generator = torch.Generator().manual_seed(0)
    sums = torch.rand(500, 2, SUMS, generator=generator)
    sums[:50] = 0.0
    reflectance = Reflectance(*(torch.rand(500, 3, generator=generator) for _ in range(2)), torch.rand(2, 500, generator=generator))
    return sums, reflectance, prepare_light(np.random.default_rng(0).random((16, 32, 3)).astype(np.float32))


@pytest.mark.parametrize("ratio", [True, False])
def test_kernel_equals_the_definition(given, ratio):
    sums, reflectance, light = given
    found = estimate_reflected_light(sums, 32, reflectance, light, ratio)
    in_double = Reflectance(*(getattr(reflectance, name).double() for name in ("diffuse", "f0", "place")))
    known = light.irradiance_at(*reflectance.place).double() if ratio else None
    expected = estimate_reference(sums.double(), 32, in_double, known)
    for name in PARTS:
        assert torch.allclose(getattr(found, name).double(), getattr(expected, name), rtol=1e-4, atol=1e-5), name
    assert found.samples == 32
    assert not found.diffuse[:50].any()


def test_known_irradiance_corrects_by_a_bounded_factor(given):
    sums, reflectance, light = given
    plain, corrected = (estimate_reflected_light(sums[50:], 32, _of(reflectance, 50), light, ratio).diffuse for ratio in (False, True))
    factor = corrected / plain
    assert factor.max() == pytest.approx(MAX_CORRECTION, rel=1e-5)
    assert factor.min() >= 1 / MAX_CORRECTION - 1e-5


def _of(reflectance: Reflectance, first: int) -> Reflectance:
    return Reflectance(reflectance.diffuse[first:], reflectance.f0[first:], reflectance.place[:, first:])
