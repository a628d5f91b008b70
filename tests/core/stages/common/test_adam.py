# SPDX-License-Identifier: GPL-3.0-or-later
"""Adam without torch's compiler: torch's own up to rounding."""

import sys

import pytest
import torch
from irgspp.core.stages.common.adam import Adam

pytestmark = pytest.mark.usefixtures("engine")


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
    assert torch.allclose(fitted(Adam), fitted(torch.optim.Adam), rtol=1e-6, atol=1e-7)


@pytest.mark.parametrize("count", [1, 8, 1001, (1 << 17) + 3])
def test_every_value_and_moment_is_stepped_on_once(count):
    generator = torch.Generator().manual_seed(count)
    value, gradient = torch.randn(2, count, generator=generator)
    states = []
    for optimizer in (Adam, torch.optim.Adam):
        leaf = value.clone().requires_grad_()
        adam = optimizer([{"params": [leaf], "lr": 0.1}], eps=1e-15, fused=True)
        for step in range(3):
            leaf.grad = gradient * (1 + step)
            adam.step()
        state = [torch.as_tensor(adam.state[leaf][key], dtype=torch.float32) for key in ("step", "exp_avg", "exp_avg_sq")]
        states.append([leaf.detach(), *state])
    assert all(torch.allclose(a, b, rtol=1e-5, atol=1e-7) for a, b in zip(*states, strict=True))


def test_rows_without_a_gradient_may_be_left_out():
    """Their values and moments stay as they are, as they would in a step."""
    generator, results = torch.Generator().manual_seed(0), []
    value, gradient = torch.randn(2, 5, 3, 20, generator=generator)
    gradient[2:] = 0
    for rows in (2, 5):
        leaf = value.clone().requires_grad_()
        adam = Adam([{"params": [leaf], "lr": 0.1, "rows": rows}], eps=1e-15)
        for _ in range(3):
            leaf.grad = gradient
            adam.step()
        results.append([leaf.detach(), adam.state[leaf]["exp_avg"], adam.state[leaf]["exp_avg_sq"]])
    assert all(torch.equal(a, b) for a, b in zip(*results, strict=True))
    assert torch.equal(results[0][0][2:], value[2:]) and not torch.equal(results[0][0][:2], value[:2])


def test_the_compiler_is_not_imported(monkeypatch):
    monkeypatch.setitem(sys.modules, "torch._dynamo", None)  # an import raises ModuleNotFoundError
    values = torch.ones(3, requires_grad=True)
    adam = Adam([{"params": [values], "lr": 0.1}], fused=True)
    values.sum().backward()
    adam.step()
    adam.zero_grad()
    assert torch.allclose(values, torch.tensor(0.9))


def test_more_tensors_than_one_launch_takes_are_all_stepped_on():
    generator, results = torch.Generator().manual_seed(0), []
    start = [torch.randn(count % 4, 3, generator=generator) for count in range(40)]  # some of them empty
    for optimizer in (Adam, torch.optim.Adam):
        leaves = [value.clone().requires_grad_() for value in start]
        adam = optimizer([{"params": [leaf], "lr": 0.01 * (1 + i)} for i, leaf in enumerate(leaves)], eps=1e-15, fused=True)
        for _ in range(3):
            sum((leaf**3).sum() for leaf in leaves).backward()
            adam.step()
            adam.zero_grad()
        results.append(torch.cat(leaves).detach())
    torch.testing.assert_close(*results, rtol=1e-5, atol=1e-6)
