# SPDX-License-Identifier: GPL-3.0-or-later
"""Cache of training views, prepared on first use."""

from __future__ import annotations

import math
from collections.abc import Sequence

import torch

from ...machine.lazy_sequence import LazySequence
from ...scene.dataset import View
from .training_view import TrainingView, make_training_view


class TrainingViewCache(LazySequence[TrainingView]):
    """Sequence of training views; a prepared view takes three times the memory of its photograph.

    Args:
        views: photographs with cameras and masks.
        reduction: factor by which the images are reduced, see `make_training_view`.
        crop: crop the images, see `make_training_view`.
        device: device that holds the views; on a GPU all are kept, since only what fits is placed there.
        memory: largest number of bytes to keep in main memory.
    """

    def __init__(
        self, views: Sequence[View], reduction: int = 1, crop: bool = False, device: torch.device | str = "cpu", memory: int = 1 << 30
    ) -> None:
        self._device = torch.device(device)
        super().__init__(len(views), memory if self._device.type == "cpu" else math.inf)
        self._views, self._reduction, self._crop = views, reduction, crop

    def make(self, index: int) -> TrainingView:
        """Prepare a view."""
        return make_training_view(self._views[index], self._reduction, self._crop).to(self._device)

    def size(self, index: int, item: TrainingView) -> int:
        """Return the bytes that a view takes."""
        return item.size
