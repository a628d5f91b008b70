# SPDX-License-Identifier: GPL-3.0-or-later
"""Linear systems of the solver: the damped Gauss-Newton step of the light."""

from __future__ import annotations

from collections.abc import Sequence

import torch

DAMPING = 1e-3  # fraction of the Hessian's diagonal that is added to it (Levenberg-Marquardt)
MAX_LOG_STEP = 1  # largest change of a texel's log radiance in a step


def damped_step(
    light: torch.Tensor, hessians: Sequence[torch.Tensor], gradient: torch.Tensor, prior: tuple[torch.Tensor, torch.Tensor]
) -> tuple[torch.Tensor, torch.Tensor]:
    """Compute a damped Gauss-Newton step of the logarithm of a light.

    Args:
        light: (T, 3) linear radiance of the texels, > 0.
        hessians: (T, T) of each channel's error, with respect to the light.
        gradient: (T, 3) of the error, with respect to the light.
        prior: quadratic form (T, T) of a channel's log radiance that is added to the error, and its gradient (T, 3).

    Returns:
        (T, 3) to be subtracted from the log radiance, and the curvature (3,) of the error and the prior in each channel's log brightness.
    """
    form, slope = prior
    steps, curvature = [], []
    for c, linear in enumerate(hessians):
        radiance = light[:, c]
        hessian = radiance[:, None] * linear * radiance  # with respect to the logarithm of the light
        damped = hessian + form + torch.diag(DAMPING * hessian.diagonal() + 1e-10)
        right = radiance * gradient[:, c] + slope[:, c]
        steps.append(solve_positive(damped.double(), right.double()).float())
        curvature.append(hessian.sum() + form.sum())
    return torch.stack(steps, 1).clamp(-MAX_LOG_STEP, MAX_LOG_STEP), torch.stack(curvature)


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
