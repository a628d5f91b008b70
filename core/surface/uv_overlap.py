# SPDX-License-Identifier: GPL-3.0-or-later
"""Overlap of faces in UV space: which texels several faces cover."""

from __future__ import annotations

import numpy as np

from ..kernels.cpu.jit import kernel

MARGIN = 0.02  # cells by which a cell's centre must lie inside a face: shared borders are no overlap


def covering_faces(uvs: np.ndarray, faces: np.ndarray, size: int) -> np.ndarray:
    """Count the faces over each cell of the texture.

    Args:
        uvs: (V, 2) in 0..1.
        faces: (F, 3).
        size: cells along a side.

    Returns:
        (size, size) uint8: faces whose interior, less a margin, holds the cell's centre; rows count from v = 0.
    """
    count = np.zeros((size, size), np.uint8)
    count_faces(0, len(faces), uvs.astype(np.float64) * size, faces, count)
    return count


@kernel
def count_faces(begin, end, corners, faces, count):
    """Add one to the cells of `count` (H, W) uint8 whose centres lie inside the faces begin..end, at least MARGIN away from the edges."""
    height, width = count.shape
    for f in range(begin, end):
        ax, ay = corners[faces[f, 0], 0], corners[faces[f, 0], 1]
        bx, by = corners[faces[f, 1], 0], corners[faces[f, 1], 1]
        cx, cy = corners[faces[f, 2], 0], corners[faces[f, 2], 1]
        side = 1.0 if (bx - ax) * (cy - ay) - (by - ay) * (cx - ax) > 0 else -1.0
        ab = MARGIN * np.sqrt((bx - ax) ** 2 + (by - ay) ** 2)
        bc = MARGIN * np.sqrt((cx - bx) ** 2 + (cy - by) ** 2)
        ca = MARGIN * np.sqrt((ax - cx) ** 2 + (ay - cy) ** 2)
        bottom, top = max(int(min(ay, by, cy)), 0), min(int(max(ay, by, cy)) + 1, height)
        left, right = max(int(min(ax, bx, cx)), 0), min(int(max(ax, bx, cx)) + 1, width)
        for row in range(bottom, top):
            for column in range(left, right):
                x, y = column + 0.5, row + 0.5
                inside = side * ((bx - ax) * (y - ay) - (by - ay) * (x - ax)) > ab
                inside = inside and side * ((cx - bx) * (y - by) - (cy - by) * (x - bx)) > bc
                inside = inside and side * ((ax - cx) * (y - cy) - (ay - cy) * (x - cx)) > ca
                if inside and count[row, column] < 255:
                    count[row, column] += 1
