# SPDX-License-Identifier: GPL-3.0-or-later
"""Adam over a changing set of Gaussians against a plain Adam over separate tensors."""

import io
import math

import pytest
import torch
from irgspp.core.errors import IrgsppError
from irgspp.core.stages.common.optimizer import ROWS, GaussianOptimizer, Rate

RATES = {"position": Rate(1e-2, 0.1), "sh_dc": Rate(2e-2), "sh_rest": Rate(1e-3, 0.5), "albedo": Rate(3e-2), "light": Rate(5e-2, 0.2)}
STEPS = 5


def gradients(optimizer, step):
    """Set a reproducible gradient for every leaf and other tensor."""
    generator = torch.Generator().manual_seed(step)
    for tensor in (*optimizer.leaves.values(), *optimizer.others.values()):
        tensor.grad = torch.randn(tensor.shape, generator=generator)


def part(optimizer, name):
    if name in optimizer.others:
        return optimizer.others[name]
    leaf, rows = ROWS.get(name, (name, slice(None)))
    return optimizer.leaves[leaf][rows]


def part_gradient(optimizer, name):
    if name in optimizer.others:
        return optimizer.others[name].grad
    leaf, rows = ROWS.get(name, (name, slice(None)))
    return optimizer.leaves[leaf].grad[rows]


@pytest.fixture
def optimizer(some_gaussians):
    return GaussianOptimizer(some_gaussians(20, 1), RATES, {"light": torch.ones(4, 8, 3, requires_grad=True)})


def test_groups_step_as_separate_tensors_would(optimizer):
    plain = {name: part(optimizer, name).detach().clone().requires_grad_() for name in RATES}
    reference = torch.optim.Adam([{"params": [p], "name": name} for name, p in plain.items()], eps=1e-15)
    untouched = optimizer.leaves["opacity"].detach().clone(), optimizer.leaves["material"].detach()[3:].clone()
    for step in range(STEPS):
        gradients(optimizer, step)
        for group in reference.param_groups:
            name = group["name"]
            group["lr"] = RATES[name].start * RATES[name].final ** (step / STEPS)
            group["params"][0].grad = part_gradient(optimizer, name).clone()
        reference.step()
        optimizer.step(step / STEPS)
        for name, expected in plain.items():
            assert torch.allclose(part(optimizer, name), expected, rtol=1e-5, atol=1e-7), (step, name)
    assert torch.equal(optimizer.leaves["opacity"], untouched[0])
    assert torch.equal(optimizer.leaves["material"][3:], untouched[1])
    assert all(t.grad is None for t in optimizer.leaves.values())


def test_rebuild_keeps_the_moments_of_survivors(optimizer):
    for step in range(3):
        gradients(optimizer, step)
        optimizer.step(0.0)
    before = {k: v.clone() for k, v in optimizer.state()["moments"].items()}
    origin = torch.tensor([4, 0, -1, 19, 7])
    optimizer.rebuild(optimizer.gaussians.select(origin.clamp_min(0)), origin)
    assert optimizer.gaussians.count == 5
    after = optimizer.state()["moments"]
    kept = origin >= 0
    for name in RATES:
        for moment in ("exp_avg", "exp_avg_sq"):
            old, new = before[f"{name}.{moment}"], after[f"{name}.{moment}"]
            if name == "light":
                assert torch.equal(new, old)
                continue
            assert torch.equal(new[..., kept], old[..., origin[kept]])
            assert not new[..., ~kept].any()
    values = optimizer.leaves["position"].detach().clone()
    gradients(optimizer, 9)
    gradient = optimizer.leaves["position"].grad.clone()
    optimizer.step(0.0)
    first, second = 0.9 * after_moment(before, origin, "exp_avg") + 0.1 * gradient, None
    second = 0.999 * after_moment(before, origin, "exp_avg_sq") + 0.001 * gradient**2
    expected = values - 1e-2 * (first / (1 - 0.9**4)) / (second / (1 - 0.999**4)).sqrt()
    assert torch.allclose(optimizer.leaves["position"], expected, atol=1e-6)


def after_moment(before, origin, moment):
    return torch.where(origin >= 0, before[f"position.{moment}"][..., origin.clamp_min(0)], 0.0)


def test_restored_state_goes_on_bit_equal(optimizer, some_gaussians):
    for step in range(3):
        gradients(optimizer, step)
        optimizer.step(0.1 * step)
    file = io.BytesIO()
    torch.save(optimizer.state(), file)
    other = GaussianOptimizer(some_gaussians(7, 5), RATES, {"light": torch.zeros(4, 8, 3, requires_grad=True)})
    other.restore(torch.load(io.BytesIO(file.getvalue())))
    for step in range(3, 6):
        for each in (optimizer, other):
            gradients(each, step)
            each.step(0.1 * step)
    for name in RATES:
        assert torch.equal(part(optimizer, name), part(other, name)), name


def test_forgotten_moments_are_those_of_one_group(optimizer):
    gradients(optimizer, 0)
    optimizer.step(0.0)
    optimizer.reset_moments("sh_dc")
    moments = optimizer.state()["moments"]
    assert not moments["sh_dc.exp_avg"].any() and not moments["sh_dc.exp_avg_sq"].any()
    assert moments["sh_rest.exp_avg"].all() and moments["position.exp_avg"].all()


def test_the_gaussians_it_was_given_stay_as_they_are(some_gaussians):
    given = some_gaussians(20, 1)
    optimizer = GaussianOptimizer(given, RATES, {"light": torch.ones(4, 8, 3, requires_grad=True)})
    gradients(optimizer, 0)
    optimizer.step(0.0)
    assert torch.equal(given.position, some_gaussians(20, 1).position)


BAD = [math.nan, math.inf, -math.inf]
PARTS = ["position", "quaternion", "log_scale", "opacity", "sh_dc", "sh_rest", "albedo", "roughness", "metallic", "light"]


@pytest.mark.parametrize("bad", BAD)
@pytest.mark.parametrize("name", PARTS)
def test_one_bad_value_stops_the_step_by_name_and_iteration(optimizer, name, bad):
    for step in range(3):
        gradients(optimizer, step)
        optimizer.step(0.0)
    with torch.no_grad():
        part(optimizer, name).view(-1)[5] = bad
    gradients(optimizer, 3)
    with pytest.raises(IrgsppError, match=rf"^{name} is not finite after iteration 4 \(1 of {part(optimizer, name).numel()} values\)$"):
        optimizer.step(0.0)


@pytest.mark.parametrize("bad", BAD)
@pytest.mark.parametrize("name", RATES)
def test_one_bad_gradient_stops_the_step_by_name_and_iteration(optimizer, name, bad):
    gradients(optimizer, 0)
    optimizer.step(0.0)
    gradients(optimizer, 1)
    part_gradient(optimizer, name).view(-1)[7] = bad
    with pytest.raises(IrgsppError, match=f"^{name} is not finite after iteration 2 .*made by a gradient"):
        optimizer.step(0.0)


def test_bad_values_are_refused_where_they_are_given(some_gaussians, optimizer):
    given = some_gaussians(20, 1)
    given.quaternion[2, 3] = math.nan
    with pytest.raises(IrgsppError, match="quaternion is not finite after iteration 0"):
        GaussianOptimizer(given, RATES, {"light": torch.ones(4, 8, 3)})
    gradients(optimizer, 0)
    optimizer.step(0.0)
    state = optimizer.state()
    with pytest.raises(IrgsppError, match="quaternion is not finite after iteration 1"):
        optimizer.rebuild(given, torch.arange(20))
    state["others"]["light"] = torch.full((4, 8, 3), math.inf)
    with pytest.raises(IrgsppError, match="light is not finite"):
        optimizer.restore(state)


def test_large_values_are_not_bad_ones(optimizer):
    with torch.no_grad():
        optimizer.leaves["log_scale"].fill_(3e38)  # their sum overflows
    gradients(optimizer, 0)
    optimizer.step(0.0)
