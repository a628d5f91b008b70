# SPDX-License-Identifier: GPL-3.0-or-later
"""Adam without torch's compiler: torch's own to the bit."""

import sys

import torch
from irgspp.core.stages.common.adam import Adam


def fitted(optimizer):
    """Parameters after some steps with different learning rates."""
    generator = torch.Generator().manual_seed(0)
    values = [torch.randn(50, generator=generator).requires_grad_() for _ in range(2)]
    adam = optimizer([{"params": [values[0]], "lr": 0.1}, {"params": [values[1]], "lr": 0.01}], eps=1e-15, fused=True)
    for _ in range(5):
        (values[0] ** 2 + torch.sin(values[1])).sum().backward()
        adam.step()
        adam.zero_grad()
    return torch.cat(values)


def test_steps_are_those_of_torch():
    assert torch.equal(fitted(Adam), fitted(torch.optim.Adam))


def test_the_compiler_is_not_imported(monkeypatch):
    monkeypatch.setitem(sys.modules, "torch._dynamo", None)  # an import raises ModuleNotFoundError
    values = torch.ones(3, requires_grad=True)
    adam = Adam([{"params": [values], "lr": 0.1}], fused=True)
    values.sum().backward()
    adam.step()
    adam.zero_grad()
    assert torch.allclose(values, torch.tensor(0.9))
