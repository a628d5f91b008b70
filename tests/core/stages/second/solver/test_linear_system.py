# SPDX-License-Identifier: GPL-3.0-or-later
"""Linear systems of the solver, against their definition."""

import pytest
import torch
from irgspp.core.stages.second.solver.linear_system import MAX_LOG_STEP, damped_step, solve_positive


@pytest.mark.parametrize("count", [1, 7, 200])
def test_solution_of_a_positive_definite_system(count):
    generator = torch.Generator().manual_seed(count)
    root = torch.randn(count, count, dtype=torch.float64, generator=generator)
    expected = torch.randn(count, dtype=torch.float64, generator=generator)
    matrix = root @ root.T + 0.1 * torch.eye(count)
    torch.testing.assert_close(solve_positive(matrix, matrix @ expected), expected, rtol=1e-8, atol=1e-8)


def test_an_indefinite_matrix_is_solved_too():
    matrix = torch.tensor([[1.0, 2.0], [2.0, -1.0]], dtype=torch.float64)
    expected = torch.tensor([0.5, -3.0], dtype=torch.float64)
    torch.testing.assert_close(solve_positive(matrix, matrix @ expected), expected)


def test_steps_lead_to_the_light_that_explains_radiance():
    generator = torch.Generator().manual_seed(3)
    rows, true = torch.rand(60, 8, generator=generator), torch.rand(8, 3, generator=generator) + 0.3
    light, form = torch.full((8, 3), 5.0), 1e-7 * torch.eye(8)
    for _ in range(30):
        gradient = rows.T @ (rows @ (light - true))
        step, curvature = damped_step(light, [rows.T @ rows] * 3, gradient, (form, form @ light.log()))
        assert step.abs().max() <= MAX_LOG_STEP
        light = (light.log() - step).exp()
    torch.testing.assert_close(light, true, rtol=1e-3, atol=0)
    torch.testing.assert_close(curvature, ((rows @ true) ** 2).sum(0), rtol=1e-2, atol=0)
