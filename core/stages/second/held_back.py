# SPDX-License-Identifier: GPL-3.0-or-later
"""Views held back by the second stage: they judge a refinement, so that neither its start nor its steps may have seen them."""

from __future__ import annotations

from dataclasses import replace

import torch

from ...scene.dataset import Dataset

HOLD_BACK = 8  # one of so many views is held back


def held_back(count: int) -> torch.Tensor:
    """Return which of so many training views are held back, (V,) bool; none of fewer than HOLD_BACK, which are all needed."""
    number = torch.arange(count)
    return number % HOLD_BACK == HOLD_BACK // 2 if count >= HOLD_BACK else number < 0


def without_held_back(dataset: Dataset) -> Dataset:
    """Return a dataset without the training views that are held back."""
    held = held_back(len(dataset.train)).tolist()
    return replace(dataset, train=[view for view, out in zip(dataset.train, held, strict=True) if not out])
