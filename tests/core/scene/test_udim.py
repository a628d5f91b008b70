# SPDX-License-Identifier: GPL-3.0-or-later
"""UDIM tiles: their numbers, and the parts of an image that they are."""

import numpy as np
from irgspp.core.scene.udim import tile_images, tile_number, tile_numbers


def test_numbers_count_columns_first_and_rows_by_ten():
    assert tile_number(0, 0) == 1001 and tile_number(9, 0) == 1010 and tile_number(2, 3) == 1033
    assert tile_numbers(3) == [1001, 1002, 1003, 1011, 1012, 1013, 1021, 1022, 1023]


def test_the_first_tile_is_at_the_lower_left():
    v, u = np.meshgrid(np.linspace(1, 0, 12), np.linspace(0, 1, 12), indexing="ij")  # row 0 is the top, v = 1
    tiles = tile_images({"albedo": np.stack([u, v, 0 * u], -1), "roughness": v}, 3)
    assert sorted(tiles) == sorted(f"{name}.{number}" for name in ("albedo", "roughness") for number in tile_numbers(3))
    assert tiles["albedo.1001"].shape == (4, 4, 3) and tiles["albedo.1001"].max() < 1 / 3
    assert tiles["albedo.1003"][..., 0].min() > 2 / 3 > 1 / 3 > tiles["albedo.1003"][..., 1].max()
    assert tiles["roughness.1021"].min() > 2 / 3
