# SPDX-License-Identifier: GPL-3.0-or-later
"""Minimum of sampled functions."""

from __future__ import annotations

import torch


def parabola_minimum(knots: torch.Tensor, cost: torch.Tensor) -> torch.Tensor:
    """Find the minima of costs: the vertex of the parabola through the least cost and its neighbours.

    Args:
        knots: (J,) ascending, at least 3.
        cost: (P, J) at the knots.

    Returns:
        (P,), within the knots.
    """
    row, j = torch.arange(len(cost), device=cost.device), cost.argmin(1).clamp(1, len(knots) - 2)
    below, least, above = cost[row, j - 1], cost[row, j], cost[row, j + 1]
    shift = ((below - above) / (2 * (below - 2 * least + above)).clamp_min(1e-6)).clamp(-1, 1)
    return knots[j] + torch.where(shift < 0, shift * (knots[j] - knots[j - 1]), shift * (knots[j + 1] - knots[j]))
