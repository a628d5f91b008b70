# SPDX-License-Identifier: GPL-3.0-or-later
"""UDIM tiles of textures: numbers, files, and where charts lie; in memory and for the engine they are one image."""

from __future__ import annotations

import numpy as np

MOST_TILES = 4  # along a side
FOLDER = "udim"  # of the tiles, in textures/ of a run
ALL_TILES = "<UDIM>"  # stands for the number in a path that names all tiles


def tile_number(column: int, row: int) -> int:
    """Return the UDIM number of the tile at u in column..column + 1 and v in row..row + 1.

    Args:
        column: from the left, 0 to 9.
        row: from the bottom, 0 and more.
    """
    return 1001 + column + 10 * row


def tile_numbers(tiles: int) -> list[int]:
    """Return the UDIM numbers of `tiles` x `tiles` tiles, ascending."""
    return [tile_number(column, row) for row in range(tiles) for column in range(tiles)]


def tile_images(textures: dict[str, np.ndarray], tiles: int) -> dict[str, np.ndarray]:
    """Slice textures into tiles.

    Args:
        textures: (T, T) or (T, T, 3) by name; row 0 is the top of the image, v = 1.
        tiles: along a side; a divisor of T.

    Returns:
        Views (T / tiles, T / tiles[, 3]) by names such as "albedo.1001".
    """
    found = {}
    for name, texture in textures.items():
        side = len(texture) // tiles
        for row in range(tiles):
            for column in range(tiles):
                top, left = (tiles - 1 - row) * side, column * side
                found[f"{name}.{tile_number(column, row)}"] = texture[top : top + side, left : left + side]
    return found
