# SPDX-License-Identifier: GPL-3.0-or-later
"""Reference of front-to-back compositing."""

from __future__ import annotations

import torch

from ..constants import (
    TRANSMITTANCE_MIN,
)


def weights(alpha):
    """Weights along dim 1 of alphas sorted front to back; nearly opaque counts as opaque: there they are divided by their sum."""
    through = torch.cumprod(1 - alpha, 1)
    before = torch.cat([torch.ones_like(through[:, :1]), through[:, :-1]], 1)
    weight = torch.where(before > TRANSMITTANCE_MIN, alpha * before, 0.0)
    total = weight.sum(1, keepdim=True)
    return torch.where((1 - total) <= TRANSMITTANCE_MIN, weight / total.clamp_min(0.5), weight)
