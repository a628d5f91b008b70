# SPDX-License-Identifier: GPL-3.0-or-later
"""Unit vectors: the same values and gradients as PyTorch's own, also at zero."""

from __future__ import annotations

import torch
from irgspp.core.scene.unit_vectors import unit_vectors


def test_agrees_with_torch() -> None:
    vectors = torch.randn(3, 20, 5, generator=torch.Generator().manual_seed(1), dtype=torch.float64, requires_grad=True)
    own, expected = unit_vectors(vectors), torch.nn.functional.normalize(vectors, dim=0)
    torch.testing.assert_close(own, expected)
    weight = torch.randn(own.shape, generator=torch.Generator().manual_seed(2), dtype=torch.float64)
    gradients = [torch.autograd.grad((value * weight).sum(), vectors, retain_graph=True)[0] for value in (own, expected)]
    torch.testing.assert_close(*gradients)


def test_zero_stays_zero() -> None:
    vectors = torch.zeros(4, 3, requires_grad=True)
    unit = unit_vectors(vectors)
    assert (unit == 0).all()
    unit.sum().backward()
    assert vectors.grad is not None and torch.isfinite(vectors.grad).all()
