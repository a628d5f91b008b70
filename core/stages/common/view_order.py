# SPDX-License-Identifier: GPL-3.0-or-later
"""Order in which training views are drawn: shuffled epochs."""

from __future__ import annotations

import torch


def next_view(order: torch.Tensor, held_back: torch.Tensor, generator: torch.Generator) -> tuple[int, torch.Tensor]:
    """Draw a training view; each is drawn once per epoch.

    Args:
        order: (K,) views of the current epoch that are still to come, last first.
        held_back: (V,) bool, views that are not trained on.
        generator: random generator that draws the order of an epoch.

    Returns:
        The view, and the order without it.
    """
    if not len(order):
        order = torch.randperm(len(held_back), generator=generator)
        order = order[~held_back[order]]
    return int(order[-1]), order[:-1]
