# SPDX-License-Identifier: GPL-3.0-or-later
"""Sequence whose items are made on first use and kept up to a memory limit."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Sequence
from typing import TypeVar, overload

Item = TypeVar("Item")


class LazySequence(Sequence[Item]):
    """Sequence that keeps the items made first, up to a memory limit, and makes the others at each access.

    Keeping the first ones rather than the last used ones saves the same fraction of the work in every pass over the whole sequence.

    Args:
        count: number of items.
        memory: largest number of bytes to keep; infinite for no limit.
    """

    def __init__(self, count: int, memory: float) -> None:
        self._count, self._free = count, memory
        self._kept: dict[int, Item] = {}

    @abstractmethod
    def make(self, index: int) -> Item:
        """Make the item at an index in 0..count - 1."""

    @abstractmethod
    def size(self, index: int, item: Item) -> int:
        """Return the bytes that an item takes."""

    def __len__(self) -> int:
        return self._count

    @overload
    def __getitem__(self, index: int) -> Item: ...

    @overload
    def __getitem__(self, index: slice) -> list[Item]: ...

    def __getitem__(self, index: int | slice) -> Item | list[Item]:
        if isinstance(index, slice):
            return [self[i] for i in range(*index.indices(len(self)))]
        index = range(len(self))[index]
        if index in self._kept:
            return self._kept[index]
        item = self.make(index)
        if (size := self.size(index, item)) <= self._free:
            self._free -= size
            self._kept[index] = item
        return item
