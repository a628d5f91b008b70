# SPDX-License-Identifier: GPL-3.0-or-later
"""Tangent frames of textures."""

from __future__ import annotations

import numpy as np

from .mesh_texels import flat_cross
from .meshing import unit


def tangents(vertices: np.ndarray, normals: np.ndarray, uvs: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """Compute the tangents that renderers rebuild (MikkTSpace, Mikkelsen 2008).

    Args:
        vertices: (V, 3).
        normals: (V, 3) unit.
        uvs: (V, 2).
        faces: (F, 3).

    Returns:
        (V, 4): unit tangent along +u and perpendicular to the normal, and the sign w = 1 or -1 of the bitangent along +v.
    """
    corner, uv = vertices[faces].astype(np.float64), uvs[faces].astype(np.float64)
    e1, e2 = corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0]
    d1, d2 = uv[:, 1] - uv[:, 0], uv[:, 2] - uv[:, 0]
    area = flat_cross(d1, d2)[:, None]
    direction = unit((e1 * d2[:, 1:] - e2 * d1[:, 1:]) * np.sign(area))
    total, side = np.zeros((len(vertices), 3)), np.zeros(len(vertices))
    for k in range(3):
        normal = normals[faces[:, k]].astype(np.float64)
        edges = corner[:, (k + 1) % 3] - corner[:, k], corner[:, (k + 2) % 3] - corner[:, k]
        a, b = (unit(_perpendicular(edge, normal)) for edge in edges)
        angle = np.arccos(np.clip((a * b).sum(-1), -1, 1))
        along = unit(_perpendicular(direction, normal)) * angle[:, None]
        for axis in range(3):
            total[:, axis] += np.bincount(faces[:, k], along[:, axis], len(total))
        side += np.bincount(faces[:, k], angle * np.sign(area[:, 0]), len(side))
    tangent = unit(_perpendicular(total, normals))
    return np.concatenate([tangent, np.where(side < 0, -1.0, 1.0)[:, None]], -1)


def _perpendicular(vectors: np.ndarray, normals: np.ndarray) -> np.ndarray:
    """Return the component of vectors (..., 3) perpendicular to unit normals (..., 3)."""
    return vectors - (vectors * normals).sum(-1, keepdims=True) * normals


def tangent_space(direction: np.ndarray, normal: np.ndarray, tangent: np.ndarray, side: np.ndarray) -> np.ndarray:
    """Transform world directions to the frame of tangent, bitangent = side * normal x tangent, and normal.

    Args:
        direction: (P, 3) world.
        normal: (P, 3) unit.
        tangent: (P, 3) unit.
        side: (P,) 1 or -1.

    Returns:
        (P, 3) components along tangent, bitangent and normal.
    """
    bitangent = side[:, None] * np.cross(normal, tangent)
    return np.stack([(direction * axis).sum(-1) for axis in (tangent, bitangent, normal)], -1)
