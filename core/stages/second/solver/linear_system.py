# SPDX-License-Identifier: GPL-3.0-or-later
"""Solution of the solver's linear systems."""

from __future__ import annotations

import torch


def solve_positive(matrix: torch.Tensor, right: torch.Tensor) -> torch.Tensor:
    """Solve M x = b for a symmetric positive definite matrix, by Cholesky's factors.

    MKL's LU factors wait busily for their threads: with other work on the machine's cores, 300 unknowns took 180 ms instead of 0.4.

    Args:
        matrix: (N, N) float64; where rounding has made it indefinite, LU factors are used.
        right: (N,) float64.
    """
    factor, failed = torch.linalg.cholesky_ex(matrix)
    if failed:
        return torch.linalg.solve(matrix, right)
    return torch.cholesky_solve(right[:, None], factor)[:, 0]
