# SPDX-License-Identifier: GPL-3.0-or-later
"""Order of depth and tile lists against brute force."""

import numpy as np
import pytest
from irgspp.core.kernels.constants import TILE
from irgspp.core.kernels.cpu.binning import depth_order
from irgspp.core.kernels.rasterize import bin_tiles

COLUMNS, ROWS = 7, 5


def boxes(count, seed, culled=0.2):
    rng = np.random.default_rng(seed)
    low = rng.integers(0, [COLUMNS * TILE, ROWS * TILE], (count, 2))
    high = np.minimum(low + rng.integers(0, 20, (count, 2)), [COLUMNS * TILE - 1, ROWS * TILE - 1])
    box = np.concatenate([low, high], 1).astype(np.int32)
    box[rng.random(count) < culled] = 1, 1, 0, 0
    return box


def visible(box):
    return np.flatnonzero(box[:, 0] <= box[:, 2])


@pytest.mark.parametrize("count", [0, 1, 8, 3000])
def test_order_is_a_stable_sort_of_the_visible(count):
    rng, box = np.random.default_rng(count), boxes(count, count)
    depth = np.exp(rng.normal(0, 8, count)).astype(np.float32)
    depth[: count // 2] = np.round(depth[: count // 2]) + 1  # many ties
    seen = visible(box)
    expected = seen[np.argsort(depth[seen], kind="stable")]
    assert np.array_equal(depth_order(depth, box), expected)


def test_order_of_neighbouring_floats():
    depth = np.nextafter(np.float32(1), np.float32(2)) * np.ones(100, np.float32)
    depth[::2] = 1
    box = np.tile(np.array([0, 0, 1, 1], np.int32), (100, 1))
    assert np.array_equal(depth_order(depth, box), [*range(0, 100, 2), *range(1, 100, 2)])


@pytest.mark.parametrize(("count", "culled"), [(0, 0), (30, 1.0), (500, 0.2)])
def test_tiles_list_what_touches_them_in_order(count, culled):
    box = boxes(count, count, culled)
    order = depth_order(np.random.default_rng(1).random(count, np.float32) + 1, box)
    start, entries = bin_tiles(order, box, COLUMNS, ROWS)
    assert start[0] == 0 and start[-1] == len(entries) and len(start) == COLUMNS * ROWS + 1
    for tile in range(COLUMNS * ROWS):
        x, y = tile % COLUMNS * TILE, tile // COLUMNS * TILE
        touching = [g for g in order if box[g, 0] < x + TILE and box[g, 2] >= x and box[g, 1] < y + TILE and box[g, 3] >= y]
        assert entries[start[tile] : start[tile + 1]].tolist() == touching
