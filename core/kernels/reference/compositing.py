# SPDX-License-Identifier: GPL-3.0-or-later
"""Float64 reference of front-to-back compositing."""

from __future__ import annotations

import torch

from ..constants import TRANSMITTANCE_MIN


def weights(alpha):
    """Compute compositing weights.

    Nearly opaque rays count as opaque: there the weights are divided by their sum.

    Args:
        alpha: (R, N) alphas, sorted front to back along dimension 1.

    Returns:
        (R, N) weights.
    """
    through = torch.cumprod(1 - alpha, 1)
    before = torch.cat([torch.ones_like(through[:, :1]), through[:, :-1]], 1)
    weight = torch.where(before > TRANSMITTANCE_MIN, alpha * before, 0.0)
    total = weight.sum(1, keepdim=True)
    return torch.where((1 - total) <= TRANSMITTANCE_MIN, weight / total.clamp_min(0.5), weight)
