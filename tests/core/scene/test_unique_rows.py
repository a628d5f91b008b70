# SPDX-License-Identifier: GPL-3.0-or-later
"""Unique rows and numbers are those of numpy's general functions."""

from __future__ import annotations

import numpy as np
import pytest
from irgspp.core.scene.unique_rows import unique_rows, used_numbers

OUTPUTS = ["return_index", "return_inverse", "return_counts"]


@pytest.mark.parametrize("shape", [(0, 2), (1, 3), (500, 1), (500, 2), (2000, 3)])
@pytest.mark.parametrize("span", [3, 50, 10**15])
def test_rows_are_those_of_numpy(shape, span):
    rows = np.random.default_rng(0).integers(-span, span, shape)
    rows = np.concatenate([rows, rows[: shape[0] // 2]])
    np.testing.assert_array_equal(unique_rows(rows), np.unique(rows, axis=0), strict=True)
    for chosen in ([OUTPUTS[0]], OUTPUTS[1:], OUTPUTS):
        asked = dict.fromkeys(chosen, True)
        for ours, theirs in zip(unique_rows(rows, **asked), np.unique(rows, axis=0, **asked), strict=True):
            np.testing.assert_array_equal(ours, theirs.reshape(ours.shape))


@pytest.mark.parametrize("shape", [(0,), (1,), (300,), (40, 3)])
def test_numbers_are_those_of_numpy(shape):
    numbers = np.random.default_rng(1).integers(0, 90, shape)
    used, rank = used_numbers(numbers)
    expected, inverse = np.unique(numbers, return_inverse=True)
    np.testing.assert_array_equal(used, expected)
    np.testing.assert_array_equal(rank, inverse.reshape(shape))
