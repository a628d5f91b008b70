# SPDX-License-Identifier: GPL-3.0-or-later
"""Ray tracer against brute force in float64, and against exact values."""

import math

import numpy as np
import pytest
import torch
from irgspp.core.kernels.constants import TRANSMITTANCE_MIN
from irgspp.core.kernels.cpu.trace import NEAREST
from irgspp.core.kernels.reference.trace import trace_reference
from irgspp.core.kernels.trace import EXTRA, FrozenGaussians, blend, build_tree, hit_lists, trace, transmittance
from surfel_clouds import cloud, rays

NAMES = ("position", "quaternion", "log_scale", "opacity", "sh", "extra", "origin", "direction")
pytestmark = pytest.mark.usefixtures("engine")


def both(parameters, origin, direction, degree=3):
    fast = [p.clone().float().requires_grad_() for p in [*parameters, origin, direction]]
    slow = [p.clone().double().requires_grad_() for p in [*parameters, origin, direction]]
    return fast, slow, trace(*fast, build_tree(*fast[:4]), degree), trace_reference(*slow, degree)


def relative(a, b):
    return (a - b).abs().amax(1) / b.abs().amax(1).clamp_min(1e-3)


@pytest.mark.parametrize(
    ("n", "extras", "degree", "opacity"), [(1, 0, 3, 2), (9, 0, 0, 0), (61, 2, 3, 0), (400, 9, 2, 2), (1500, 5, 1, -4)]
)
def test_forward_matches_reference(n, extras, degree, opacity):
    _, _, fast, slow = both(cloud(n, n, extras, opacity=opacity), *rays(600, 1), degree)
    error = relative(fast, slow)
    # A hit on the edge of a surfel, or two at almost the same distance, may fall on either side.
    assert (error > 1e-4).float().mean() <= 1e-3
    assert error.max() < 0.05
    assert (fast[:, -1] > 0).any()


def test_opaque_rays_are_means_and_clear_ones_are_zero():
    parameters = cloud(400, 3, opacity=4.0)
    parameters[5][0] = 0.7
    origin, direction = rays(500, 2)
    out = trace(*parameters, origin, direction, build_tree(*parameters[:4]))
    opaque, clear = out[:, -1] == 1, out[:, -1] == 0
    assert opaque.sum() > 50 and clear.sum() > 50
    assert torch.allclose(out[opaque, EXTRA], torch.tensor(0.7), atol=1e-5)
    assert not out[clear].any()
    assert not ((out[:, -1] >= 1 - TRANSMITTANCE_MIN) & ~opaque).any()


@pytest.mark.parametrize(("seed", "degree", "opacity"), [(1, 3, 0.0), (2, 2, 3.0), (3, 0, -2.0)])
def test_gradients_match_autograd(seed, degree, opacity):
    fast, slow, a, b = both(cloud(100, seed, opacity=opacity), *rays(300, seed), degree)
    weight = torch.randn(a.shape, generator=torch.Generator().manual_seed(9))
    agree = (relative(a.detach(), b.detach()) < 1e-4)[:, None]  # rays on a threshold differ by design
    assert agree.float().mean() > 0.99
    (a * weight * agree).sum().backward()
    (b * weight * agree).sum().backward()
    for name, f, s in zip(NAMES, fast, slow, strict=True):
        error = (f.grad - s.grad).norm() / s.grad.norm()
        assert error < 1e-4, f"{name}: {error:.1e}"


def test_gradients_of_opaque_rays_match_autograd():
    fast, slow, a, b = both(cloud(600, 5, size=0.3, opacity=4.0), *rays(200, 4, 0.3))
    opaque = (a[:, -1] == 1) & (relative(a.detach(), b.detach()) < 1e-4)
    assert opaque.float().mean() > 0.7
    weight = torch.randn(a.shape, generator=torch.Generator().manual_seed(9)) * opaque[:, None]
    (a * weight).sum().backward()
    (b * weight).sum().backward()
    for name, f, s in zip(NAMES, fast, slow, strict=True):
        error = (f.grad - s.grad).norm() / s.grad.norm()
        assert error < 1e-3, f"{name}: {error:.1e}"


@pytest.mark.parametrize("which", range(8), ids=NAMES)
def test_gradients_match_finite_differences(which):
    inputs = [*cloud(20, 8, size=0.6), *rays(12, 3)]
    g = torch.Generator().manual_seed(which)
    step = torch.randn(inputs[which].shape, generator=g)
    weight = torch.randn(12, 10, generator=g)

    def loss(values):
        out = trace(*values, build_tree(*values[:4]))
        return (out.double() * weight).sum()

    value = inputs[which].clone().requires_grad_()
    loss([*inputs[:which], value, *inputs[which + 1 :]]).backward()
    assert value.grad is not None
    size = 2e-3
    moved = [loss([*inputs[:which], inputs[which] + s * size * step, *inputs[which + 1 :]]) for s in (1, -1)]
    slope = float(moved[0] - moved[1]) / (2 * size)
    assert float((value.grad * step).sum()) == pytest.approx(slope, rel=2e-2, abs=2e-2)


def test_radiance_gradients_do_not_depend_on_geometry_gradients():
    parameters, (origin, direction) = cloud(80, 2), rays(200, 6)
    tree = build_tree(*parameters[:4])
    results = []
    for differentiable in (range(4, 6), range(6)):
        values = [p.clone().requires_grad_(i in differentiable) for i, p in enumerate(parameters)]
        trace(*values, origin, direction, tree).square().sum().backward()
        results.append([values[4].grad, values[5].grad])
        assert (values[0].grad is None) == (0 not in differentiable)
    for a, b in zip(*results, strict=True):
        assert torch.allclose(a, b, rtol=1e-5, atol=1e-6)


@pytest.mark.parametrize("degree", [0, 1, 2])
def test_unused_coefficients_get_no_gradient(degree):
    parameters = [p.requires_grad_() for p in cloud(40, 3)]
    trace(*parameters, *rays(200, 1), build_tree(*parameters[:4]), degree).sum().backward()
    gradient = parameters[4].grad
    assert gradient is not None and gradient[: (degree + 1) ** 2].abs().sum() > 0
    assert not gradient[(degree + 1) ** 2 :].any()


def test_without_sh_colour_is_zero_and_the_rest_the_same():
    parameters, (origin, direction) = cloud(100, 1), rays(100, 1)
    tree = build_tree(*parameters[:4])
    full = trace(*parameters, origin, direction, tree)
    extra = parameters[5].clone().requires_grad_()
    bare = trace(*parameters[:4], None, extra, origin, direction, tree)
    assert torch.equal(bare[:, 3:], full[:, 3:]) and not bare[:, :3].any()
    bare[:, EXTRA:-2].sum().backward()
    assert extra.grad is not None
    assert float((extra.grad * parameters[5]).sum()) == pytest.approx(float(bare[:, EXTRA:-2].detach().sum()), rel=1e-4)


def test_many_faint_surfels_are_all_hit():
    _, _, fast, slow = both(cloud(3000, 11, size=0.4, opacity=-4.5), *rays(60, 8))
    assert (relative(fast, slow) > 1e-4).float().mean() <= 0.02
    parameters, (origin, direction) = cloud(3000, 11, size=0.4, opacity=-4.5), rays(60, 8)
    count = np.diff(hit_lists(build_tree(*parameters[:4]), origin, direction).start)
    assert count.max() > 3 * NEAREST


@pytest.mark.parametrize("axis", range(3))
@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_rays_along_the_axes(axis, sign):
    parameters = cloud(500, 4)
    direction = torch.zeros(200, 3)
    direction[:, axis] = sign
    _, _, fast, slow = both(parameters, rays(200, 5)[0], direction)
    assert (relative(fast, slow) > 1e-4).float().mean() <= 5e-3


def test_far_origins_and_large_coordinates():
    parameters, (origin, direction) = cloud(300, 6), rays(400, 7, 0.3)
    shift = torch.tensor([50.0, -30.0, 20.0])
    parameters[0] += shift[:, None]
    _, _, fast, slow = both(parameters, origin + shift - 40 * direction, direction)
    assert (fast[:, -1] - slow[:, -1]).abs().quantile(0.99) < 1e-2  # rounding of coordinates alone
    assert (slow[:, -1] > 0.5).float().mean() > 0.1


def test_transmittance_is_one_minus_opacity():
    for opacity in (0.0, 3.0):
        parameters, (origin, direction) = cloud(500, 2, opacity=opacity), rays(1000, 3)
        tree = build_tree(*parameters[:4])
        out = trace(*parameters, origin, direction, tree)
        through = transmittance(tree, origin, direction)
        assert torch.allclose(through, 1 - out[:, -1], atol=2e-6)
        assert ((through == 0) == (out[:, -1] == 1)).all()


def test_refit_equals_rebuild():
    parameters, (origin, direction) = cloud(300, 1), rays(400, 2)
    tree = build_tree(*parameters[:4])
    moved = [p + 0.1 * torch.randn(p.shape, generator=torch.Generator().manual_seed(3)) for p in parameters]
    tree.refit(*moved[:4])
    assert torch.equal(trace(*moved, origin, direction, tree), trace(*moved, origin, direction, build_tree(*moved[:4])))


def test_a_stale_tree_is_rejected():
    parameters, (origin, direction) = cloud(30, 1), rays(4, 2)
    tree = build_tree(*parameters[:4])
    parameters[3] += 0.1
    with pytest.raises(ValueError, match="refit"):
        trace(*parameters, origin, direction, tree)


def test_shapes_are_checked():
    parameters = cloud(30, 1)
    tree = build_tree(*parameters[:4])
    with pytest.raises(ValueError, match="3"):
        transmittance(tree, torch.zeros(3, 5), torch.zeros(3, 5))
    with pytest.raises(ValueError, match="3"):
        hit_lists(tree, torch.zeros(5, 3), torch.zeros(1, 3))


@pytest.mark.parametrize(("n", "count"), [(0, 5), (20, 0)])
def test_no_surfels_or_no_rays(n, count):
    parameters = [p.requires_grad_() for p in cloud(n, 1)]
    origin, direction = (r.requires_grad_() for r in rays(count, 1))
    tree = build_tree(*parameters[:4])
    out = trace(*parameters, origin, direction, tree)
    assert out.shape == (count, 10) and not out.any()
    out.sum().backward()
    assert all(p.grad is not None and not p.grad.any() for p in parameters)
    assert torch.equal(transmittance(tree, origin, direction), torch.ones(count))
    assert blend(hit_lists(tree, origin, direction), parameters[5]).shape == (count, 2)


def test_broken_surfels_are_invisible_and_get_no_gradient():
    parameters, (origin, direction) = cloud(60, 1), rays(300, 2)
    keep = torch.arange(60) >= 6
    expected = trace(*(p[..., keep] for p in parameters), origin, direction, build_tree(*(p[..., keep] for p in parameters[:4])))
    parameters[0][1, 0] = math.nan
    parameters[1][:, 1] = math.inf
    parameters[2][0, 2] = -math.inf
    parameters[2][1, 3] = math.nan
    parameters[3][4] = math.nan
    parameters[3][5] = -50.0
    values = [p.clone().requires_grad_() for p in parameters]
    out = trace(*values, origin, direction, build_tree(*values[:4]))
    assert torch.equal(out, expected)
    out.square().sum().backward()
    for value in values:
        assert value.grad is not None
        assert torch.isfinite(value.grad).all() and not value.grad[..., :6].any()


@pytest.mark.parametrize("threads", ["1", "3"])
def test_same_input_same_bits(threads, monkeypatch):
    monkeypatch.setenv("IRGSPP_THREADS", threads)
    inputs = [*cloud(300, 7), *rays(700, 1)]
    runs = []
    for _ in range(2):
        values = [p.clone().requires_grad_() for p in inputs]
        out = trace(*values, build_tree(*values[:4]))
        out.square().sum().backward()
        runs.append([out, *(v.grad for v in values)])
    assert all(torch.equal(a, b) for a, b in zip(*runs, strict=True))


def test_results_do_not_depend_on_threads(monkeypatch):
    parameters, (origin, direction) = cloud(300, 7), rays(701, 1)
    seen = []
    for threads in ("1", "3"):
        monkeypatch.setenv("IRGSPP_THREADS", threads)
        tree = build_tree(*parameters[:4])
        seen.append((trace(*parameters, origin, direction, tree), transmittance(tree, origin, direction)))
    assert all(torch.equal(a, b) for a, b in zip(*seen, strict=True))


def test_seen_equals_trace():
    parameters, (origin, direction) = cloud(300, 5), rays(200, 5)
    tree = build_tree(*parameters[:4])
    assert torch.equal(FrozenGaussians(tree, *parameters[4:]).along(origin, direction), trace(*parameters, origin, direction, tree))
