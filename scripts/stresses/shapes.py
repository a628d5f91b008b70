# SPDX-License-Identifier: GPL-3.0-or-later
"""Triangle meshes of known shape for the cases on surfaces."""

from __future__ import annotations

import numpy as np
from irgspp.core.surface.meshing import Triangles


def ball(rows: int, radius: float = 1.0, centre: tuple[float, float, float] = (0.0, 0.0, 0.0)) -> Triangles:
    """Return a sphere of 4 rows (rows - 2) triangles, without caps at its poles but for a triangle fan each.

    Args:
        rows: number of rows.
        radius: radius.
        centre: centre.
    """
    columns = 2 * rows
    theta, phi = np.meshgrid(np.arange(1, rows) / rows * np.pi, np.arange(columns) / columns * 2 * np.pi, indexing="ij")
    ring = np.stack([np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), np.cos(theta)], -1).reshape(-1, 3)
    i, j = np.arange((rows - 2) * columns).reshape(rows - 2, columns), np.roll(np.arange(columns), -1)
    a, b, c, d = i, i[:, j], i[:, j] + columns, i + columns
    sides = np.concatenate([np.stack([a, d, c], -1).reshape(-1, 3), np.stack([a, c, b], -1).reshape(-1, 3)])
    north, south, last = len(ring), len(ring) + 1, (rows - 2) * columns
    around = np.arange(columns)
    caps = [np.stack([around * 0 + north, around, j], -1), np.stack([around * 0 + south, last + j, last + around], -1)]
    vertices = np.concatenate([ring, [[0.0, 0.0, 1.0], [0.0, 0.0, -1.0]]]) * radius + np.array(centre)
    return Triangles(vertices, np.concatenate([sides, *caps]))


def box(size: tuple[float, float, float], cells: int = 10) -> Triangles:
    """Return a closed box whose sides are grids of cells x cells squares and share no vertices.

    Args:
        size: half widths.
        cells: squares along a side.
    """
    u, v = np.meshgrid(np.linspace(-1, 1, cells + 1), np.linspace(-1, 1, cells + 1), indexing="ij")
    i = (np.arange(cells)[:, None] * (cells + 1) + np.arange(cells)).reshape(-1)
    side = np.concatenate([np.stack([i, i + cells + 1, i + cells + 2], -1), np.stack([i, i + cells + 2, i + 1], -1)])
    vertices, faces = [], []
    for axis in range(3):
        for sign in (1.0, -1.0):
            points = np.roll(np.stack([u, sign * v, np.full_like(u, sign)], -1).reshape(-1, 3), axis + 1, axis=-1)
            faces.append(side + (cells + 1) ** 2 * len(vertices))
            vertices.append(points * np.array(size))
    return Triangles(np.concatenate(vertices), np.concatenate(faces))


def round_box(cells: int) -> Triangles:
    """Return a unit sphere of 12 cells^2 triangles of similar size that share vertices."""
    mesh = box((1.0, 1.0, 1.0), cells)
    vertices, welded = np.unique(mesh.vertices.round(9), axis=0, return_inverse=True)
    return Triangles(vertices / np.linalg.norm(vertices, axis=-1, keepdims=True), welded.reshape(-1)[mesh.faces])


def joined(*parts: Triangles) -> Triangles:
    """Return several meshes as one."""
    starts = np.cumsum([0, *(len(part.vertices) for part in parts[:-1])])
    faces = [part.faces + start for part, start in zip(parts, starts, strict=True)]
    return Triangles(np.concatenate([part.vertices for part in parts]), np.concatenate(faces))


def mobius(count: int = 40) -> Triangles:
    """Return a strip with one side, whose faces can't be oriented consistently."""
    t = np.arange(count) / count * 2 * np.pi
    rim = [np.stack([(1 + s * np.cos(t / 2)) * np.cos(t), (1 + s * np.cos(t / 2)) * np.sin(t), s * np.sin(t / 2)], -1) for s in (-0.3, 0.3)]
    a, b = np.arange(count), np.roll(np.arange(count), -1)
    lower, upper = np.where(b == 0, count, b), np.where(b == 0, 0, b + count)
    faces = np.concatenate([np.stack([a, lower, a + count], -1), np.stack([lower, upper, a + count], -1)])
    return Triangles(np.concatenate(rim), faces)
