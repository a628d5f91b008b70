# SPDX-License-Identifier: GPL-3.0-or-later
"""Radiance of samples and its derivatives by the light, against plain algebra."""

import numpy as np
import pytest
import torch
from irgspp.core.kernels.jacobian import gram
from irgspp.core.shading.specular_albedo import diffuse_fraction
from irgspp.core.stages.second.solver.sample_equation import view_terms
from irgspp.core.stages.second.solver.solver_run import run_solver
from sphere_on_floor import TEXELS, make, start


@pytest.fixture(scope="module")
def halfway():
    """A solver of a small problem after some steps, with weights, and target and weight of the albedo's prior."""
    transfer, seen, _ = make(40, 15)
    solver = start(seen, transfer)
    run_solver(solver, on_step=lambda step: step == 9)
    solver.metallic[::3] = 0.5  # all terms at once
    solver._update_model()
    random = torch.Generator().manual_seed(5)
    weight = torch.rand(seen.colour.shape, generator=random)
    pull = 0.1 + torch.rand(solver.albedo.shape, generator=random)
    return solver, weight, solver.albedo.clone(), pull


def model(solver, light, channel):
    """Evaluate c and d (K,) of one channel in float64, differentiable in the light."""
    transfer, point = solver.transfer, solver.samples.point
    rows = [a.double() for a in transfer.rows(solver.samples, solver.roughness)]
    irradiance = (transfer.irradiance.double() @ light + transfer.indirect[:, channel].double())[point]
    lobe = [row @ light + own[:, channel] for row, own in zip(rows[:2], rows[2:], strict=True)]
    return view_terms(
        solver.metallic[point].double(), diffuse_fraction(solver.samples.n_v, solver.roughness[point]).double(), irradiance, *lobe
    )


def eliminated(solver, log_light, weight, anchor, pull, channel):
    """Return the weighted residuals of samples and prior with the best albedo for a light, float64; that albedo, and c."""
    point, y = solver.samples.point, solver.samples.colour[:, channel].double()
    factor, rest = model(solver, log_light.exp(), channel)
    weight, anchor, pull = (t[:, channel].double() for t in (weight, anchor, pull))
    sums = lambda values: torch.zeros_like(pull).index_add(0, point, values)  # noqa: E731
    albedo = (sums(weight * factor * (y - rest)) + pull * anchor) / (sums(weight * factor**2) + pull)
    return torch.cat([weight.sqrt() * (albedo[point] * factor + rest - y), pull.sqrt() * (albedo - anchor)]), albedo, factor


def equations(solver, weight, anchor, pull, channel):
    """Return the module's Hessian and gradient in the log light, the log light, and the residuals that they should be of."""
    log_light = solver.light[:, channel].double().log().requires_grad_()
    residuals, albedo, factor = eliminated(solver, log_light, weight, anchor, pull, channel)
    solver.albedo[:, channel] = albedo.detach().float()
    total = solver.samples.sums(weight[:, channel] * factor.detach().float() ** 2) + pull[:, channel]
    error = (residuals[: len(solver.samples.point)] * weight[:, channel].double().sqrt()).detach().float()
    of_channel = [values.detach().float()[:, None].expand(-1, 3) for values in (weight[:, channel], factor, total)]
    hessian = solver._model.hessian(solver.albedo, *of_channel)[channel]
    gradient = solver._model.gradient(solver.albedo, error[:, None].expand(-1, 3))[:, channel]
    light = solver.light[:, channel]
    return light[:, None] * hessian * light, light * gradient, log_light, residuals


def test_terms_are_those_of_the_model(halfway):
    solver = halfway[0]
    factor, rest = solver._model.terms(solver.light)
    for channel in range(3):
        expected = model(solver, solver.light[:, channel].double(), channel)
        for ours, term in zip((factor, rest), expected, strict=True):
            np.testing.assert_allclose(ours[:, channel], term, rtol=1e-4, atol=1e-6)


@pytest.mark.parametrize("channel", [0, 2])
def test_gradient_is_the_derivative_of_the_error_with_albedo_eliminated(halfway, channel):
    _, gradient, log_light, residuals = equations(*halfway, channel)
    (expected,) = torch.autograd.grad(residuals.square().sum() / 2 / len(halfway[0].samples.point), log_light)
    assert expected.abs().max() > 1e-5
    np.testing.assert_allclose(gradient, expected, rtol=1e-3, atol=1e-4 * float(expected.abs().max()))


def test_hessian_is_that_of_gauss_and_newton_with_albedo_eliminated(halfway):
    """Against the dense Jacobian of light and albedo together and its Schur complement."""
    solver, weight, anchor, pull = halfway
    hessian, _, log_light, _ = equations(solver, weight, anchor, pull, 1)

    def residuals(unknowns):
        """Return the residuals with log light and albedo as independent unknowns; the prior's target does not matter."""
        albedo = unknowns[TEXELS:]
        factor, rest = model(solver, unknowns[:TEXELS].exp(), 1)
        views = weight[:, 1].double().sqrt() * (albedo[solver.samples.point] * factor + rest)
        return torch.cat([views, pull[:, 1].double().sqrt() * albedo])

    albedo = solver.albedo[:, 1].double()
    jacobian = torch.autograd.functional.jacobian(residuals, torch.cat([log_light.detach(), albedo]), vectorize=True)
    full = jacobian.T @ jacobian / len(solver.samples.point)
    by_light, mixed, by_albedo = full[:TEXELS, :TEXELS], full[:TEXELS, TEXELS:], full[TEXELS:, TEXELS:]
    expected = by_light - mixed @ torch.linalg.solve(by_albedo, mixed.T)
    np.testing.assert_allclose(hessian, expected, atol=2e-5 * float(expected.abs().max()))
    assert torch.linalg.eigvalsh(hessian.double()).min() > -1e-6 * float(expected.abs().max())


def test_gram_is_the_product():
    rows = torch.randn(50, 200, generator=torch.Generator().manual_seed(0))
    np.testing.assert_allclose(gram(rows), rows.T @ rows, atol=1e-4)
    assert torch.equal(gram(rows), gram(rows).T)
