# SPDX-License-Identifier: GPL-3.0-or-later
"""Linear systems of the solver, against their definition."""

import pytest
import torch
from irgspp.core.stages.second.solver.linear_system import solve_positive


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
