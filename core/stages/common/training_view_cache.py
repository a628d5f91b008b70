# SPDX-License-Identifier: GPL-3.0-or-later
"""Cache of training views, prepared on first use."""

from __future__ import annotations

from collections.abc import Sequence
from typing import overload

import torch

from ...scene.dataset import View
from .training_view import TrainingView, make_training_view


class TrainingViewCache(Sequence[TrainingView]):
    """Sequence of training views; it keeps those prepared first, up to a memory limit, and prepares the others at each access.

    A prepared view takes three times the memory of its photograph. All views of a large capture at once would take tens of gigabytes;
    preparing one takes a small part of a step.

    Args:
        views: photographs with cameras and masks.
        reduction: of the images, see `make_training_view`.
        crop: crop the images, see `make_training_view`.
        device: that holds the views; on a GPU all are kept, since only what fits is placed there.
        memory: largest number of bytes to keep in main memory.
    """

    def __init__(
        self, views: Sequence[View], reduction: int = 1, crop: bool = False, device: torch.device | str = "cpu", memory: int = 1 << 30
    ) -> None:
        self._views, self._reduction, self._crop = views, reduction, crop
        self._device = torch.device(device)
        self._free = float(memory) if self._device.type == "cpu" else float("inf")
        self._cached: dict[int, TrainingView] = {}

    def __len__(self) -> int:
        return len(self._views)

    @overload
    def __getitem__(self, index: int) -> TrainingView: ...

    @overload
    def __getitem__(self, index: slice) -> list[TrainingView]: ...

    def __getitem__(self, index: int | slice) -> TrainingView | list[TrainingView]:
        if isinstance(index, slice):
            return [self[i] for i in range(*index.indices(len(self)))]
        index = range(len(self))[index]
        if index in self._cached:
            return self._cached[index]
        view = make_training_view(self._views[index], self._reduction, self._crop).to(self._device)
        if view.size <= self._free:
            self._free -= view.size
            self._cached[index] = view
        return view
