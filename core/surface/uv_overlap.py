# SPDX-License-Identifier: GPL-3.0-or-later
"""Overlap of faces in UV space: which texels several faces cover, and faces that are moved out of their chart to end it."""

from __future__ import annotations

import numpy as np
from scipy import ndimage

from ..kernels.cpu.jit import helper, kernel
from .meshing import Triangles

GRID = 4096  # cells along a side of the grid on which overlap is looked for
MARGIN = 0.02  # cells by which a cell's centre must lie inside a face: shared borders are no overlap
UNMAPPED = 1e-6  # least area of a face in UV space, texels of a texture of 1024 x 1024
PLACES = 1024  # cells along a side of the grid on which free places are looked for


def covering_faces(uvs: np.ndarray, faces: np.ndarray, size: int = GRID) -> np.ndarray:
    """Count the faces over each cell of the texture.

    Args:
        uvs: (V, 2) in 0..1.
        faces: (F, 3).
        size: cells along a side.

    Returns:
        (size, size) uint8: faces whose interior, less a margin, holds the cell's centre; rows count from v = 0.
    """
    count = np.zeros((size, size), np.uint8)
    paint_faces(0, len(faces), uvs.astype(np.float64) * size, faces, False, count, np.zeros(len(faces), np.bool_))
    return count


def without_overlap(
    mesh: Triangles, source: np.ndarray, faces: np.ndarray, uvs: np.ndarray, texture: int, padding: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Move faces that lie over others in UV space, or have no area there, to free places of the texture, each as a chart of its own.

    Args:
        mesh: mesh that was unwrapped.
        source: (V,) vertex of `mesh` that each vertex is a copy of.
        faces: (F, 3).
        uvs: (V, 2) float32 in 0..1.
        texture: texels along a side.
        padding: texels to keep free between charts.

    Returns:
        The new `source`, `faces` and `uvs`; where nothing overlaps, the given ones.
    """
    corner = uvs[faces].astype(np.float64)
    first, second = corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0]
    area = np.abs(first[:, 0] * second[:, 1] - first[:, 1] * second[:, 0]) / 2
    count, over = np.zeros((GRID, GRID), np.uint8), np.zeros(len(faces), np.bool_)
    paint_faces(0, len(faces), uvs.astype(np.float64) * GRID, faces, True, count, over)
    moved = np.nonzero(over | (area * 1024**2 < UNMAPPED))[0]
    if not len(moved):
        return source, faces, uvs
    flat = _flattened(mesh.vertices[source[faces]], area)[moved]
    blocks = count.reshape(PLACES, GRID // PLACES, PLACES, GRID // PLACES).any((1, 3))
    placed = _placed(flat, blocks, padding / texture)
    new = len(source) + np.arange(3 * len(moved))
    source = np.concatenate([source, source[faces[moved]].reshape(-1)])
    uvs = np.concatenate([uvs, placed.reshape(-1, 2).astype(np.float32)])
    faces = faces.copy()
    faces[moved] = new.reshape(-1, 3)
    used, faces = np.unique(faces, return_inverse=True)
    return source[used], faces.reshape(-1, 3).astype(np.int32), uvs[used]


def _flattened(corner: np.ndarray, area: np.ndarray) -> np.ndarray:
    """Lay triangles (F, 3, 3) flat, (F, 3, 2) around their bounding boxes' centres, at the mean scale of the areas (F,) in UV space."""
    along = corner[:, 1] - corner[:, 0]
    length = np.maximum(np.linalg.norm(along, axis=-1), 1e-300)
    other = corner[:, 2] - corner[:, 0]
    x = (other * along).sum(-1) / length
    height = np.linalg.norm(np.cross(along, other), axis=-1) / length
    scale = np.sqrt(area.sum() / max(float((length * height).sum()) / 2, 1e-300))
    zero = np.zeros(len(corner))
    flat = scale * np.stack([np.stack([zero, zero], -1), np.stack([length, zero], -1), np.stack([x, height], -1)], 1)
    return flat - (flat.min(1, keepdims=True) + flat.max(1, keepdims=True)) / 2


def _placed(flat: np.ndarray, occupied: np.ndarray, padding: float) -> np.ndarray:
    """Move triangles (N, 3, 2) to free places, the largest first, each shrunk where it doesn't fit.

    Args:
        flat: (N, 3, 2) corners around their centres, in UV units.
        occupied: (S, S) bool.
        padding: distance to keep free around each, UV units.
    """
    size = len(occupied)
    free = np.asarray(ndimage.distance_transform_edt(np.pad(~occupied, 1)))[1:-1, 1:-1]
    free = np.maximum(free - 1, 0) / size  # from a cell's centre to the nearest occupied cell's border
    y, x = (np.mgrid[:size, :size] + 0.5) / size
    radius = np.linalg.norm(flat, axis=-1).max(-1)
    placed = np.empty_like(flat)
    for i in np.argsort(-radius, kind="stable"):
        row, column = np.unravel_index(np.argmax(free), free.shape)
        room = max(float(free[row, column]) - padding, 0.1 / size)
        factor = min(1.0, room / max(radius[i], 1e-300))
        centre = np.array([x[row, column], y[row, column]])
        placed[i] = centre + factor * flat[i]
        taken = np.hypot(x - centre[0], y - centre[1]) - factor * radius[i]
        free = np.minimum(free, np.maximum(taken, 0))
    return placed


@kernel
def paint_faces(begin, end, corners, faces, single, count, over):
    """Add one to the cells of `count` (H, W) uint8 inside the faces begin..end; with `single` mark those over others in `over` instead."""
    for f in range(begin, end):
        if single and _painted(corners, faces[f], count, False) > 0:
            over[f] = True
            continue
        _painted(corners, faces[f], count, True)


@helper
def _painted(corners, face, count, paint):
    """Return the number of cells inside a face, by at least MARGIN from its edges, that are counted already; count them if `paint`."""
    height, width = count.shape
    ax, ay = corners[face[0], 0], corners[face[0], 1]
    bx, by = corners[face[1], 0], corners[face[1], 1]
    cx, cy = corners[face[2], 0], corners[face[2], 1]
    side = 1.0 if (bx - ax) * (cy - ay) - (by - ay) * (cx - ax) > 0 else -1.0
    ab = MARGIN * np.sqrt((bx - ax) ** 2 + (by - ay) ** 2)
    bc = MARGIN * np.sqrt((cx - bx) ** 2 + (cy - by) ** 2)
    ca = MARGIN * np.sqrt((ax - cx) ** 2 + (ay - cy) ** 2)
    bottom, top = max(int(min(ay, by, cy)), 0), min(int(max(ay, by, cy)) + 1, height)
    left, right = max(int(min(ax, bx, cx)), 0), min(int(max(ax, bx, cx)) + 1, width)
    found = 0
    for row in range(bottom, top):
        for column in range(left, right):
            x, y = column + 0.5, row + 0.5
            inside = side * ((bx - ax) * (y - ay) - (by - ay) * (x - ax)) > ab
            inside = inside and side * ((cx - bx) * (y - by) - (cy - by) * (x - bx)) > bc
            inside = inside and side * ((ax - cx) * (y - cy) - (ay - cy) * (x - cx)) > ca
            if inside:
                found += 1 if count[row, column] > 0 else 0
                if paint and count[row, column] < 255:
                    count[row, column] += 1
    return found
