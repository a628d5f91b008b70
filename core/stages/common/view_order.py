# SPDX-License-Identifier: GPL-3.0-or-later
"""Order in which training views are drawn: shuffled epochs."""

from __future__ import annotations

import math
from itertools import chain

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


def shuffled_epochs(views: int, draws: int, generator: torch.Generator) -> list[int]:
    """Draw training views all at once; each is drawn once per epoch. The order is not that of `next_view`.

    Args:
        views: number of views, > 0.
        draws: number of draws.
        generator: of the epochs.

    Returns:
        The views in the order in which they are drawn, 0..views - 1.
    """
    epochs = (torch.randperm(views, generator=generator).tolist() for _ in range(math.ceil(draws / views)))
    return list(chain.from_iterable(epochs))[:draws]
