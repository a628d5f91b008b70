# SPDX-License-Identifier: GPL-3.0-or-later
"""Texture baking: rasterisation of triangles in UV space, tangent frames, and normals with detail."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import ndimage

from ..kernels.cpu.jit import kernel
from .meshing import unit

NOISE_RATIO = 1.5  # differences between two normals below this multiple of their median count as noise
MAX_NORMAL_SINE = 0.8  # sine of the largest angle between the normals of texture and mesh


@dataclass(frozen=True, eq=False)
class Texels:
    """Texels whose centre lies in a triangle.

    Attributes:
        size: texels along a side of the texture.
        row: (P,) of each texel, from the image's top.
        column: (P,).
        face: (P,) index of the triangle.
        barycentric: (P, 3) float64 coordinates of the texel's centre.
    """

    size: int
    row: np.ndarray
    column: np.ndarray
    face: np.ndarray
    barycentric: np.ndarray

    def interpolate(self, values: np.ndarray, faces: np.ndarray) -> np.ndarray:
        """Interpolate vertex values at the texels.

        Args:
            values: (V, C) at the vertices.
            faces: (F, 3) vertices of the triangles.

        Returns:
            (P, C).
        """
        return (values[faces[self.face]] * self.barycentric[..., None]).sum(1)

    def image(self, values: np.ndarray) -> np.ndarray:
        """Make an image (size, size, ...) of texel values (P, ...); texels outside all triangles take the nearest value."""
        known = np.zeros((self.size, self.size), bool)
        known[self.row, self.column] = True
        image = np.zeros((self.size, self.size, *values.shape[1:]), values.dtype)
        image[self.row, self.column] = values
        nearest = np.asarray(ndimage.distance_transform_edt(~known, return_distances=False, return_indices=True))
        return image[nearest[0], nearest[1]]


def rasterise(uvs: np.ndarray, faces: np.ndarray, size: int) -> Texels:
    """Find the texels whose centre lies in a triangle.

    Args:
        uvs: (V, 2) in 0..1; v = 0 is the bottom of the image.
        faces: (F, 3) vertices of the triangles.
        size: texels along a side of the texture.
    """
    corners, owner = texel_owners(uvs, faces, size)
    row, column = np.nonzero(owner >= 0)
    face = owner[row, column]
    return Texels(size, row, column, face, barycentric(corners[faces[face]], np.stack([column + 0.5, row + 0.5], -1)))


def texel_owners(uvs: np.ndarray, faces: np.ndarray, size: int) -> tuple[np.ndarray, np.ndarray]:
    """Find the triangle over each texel's centre; where several are, the last one.

    Args:
        uvs: (V, 2) in 0..1; v = 0 is the bottom of the image.
        faces: (F, 3) vertices of the triangles.
        size: texels along a side of the texture.

    Returns:
        The vertices (V, 2) float64 as column and row, with texel centres at .5, and the triangles (size, size) int32, -1 where none is.
    """
    corners = uvs.astype(np.float64) * size
    corners[:, 1] = size - corners[:, 1]
    owner = np.full((size, size), -1, np.int32)
    fill_owners(0, len(faces), corners, faces, owner)
    return corners, owner


def barycentric(triangle: np.ndarray, point: np.ndarray) -> np.ndarray:
    """Compute barycentric coordinates.

    Args:
        triangle: (P, 3, 2) corners in the plane.
        point: (P, 2), one in each triangle.

    Returns:
        (P, 3) weights of the corners, of sum 1, outside 0..1 for a point outside; finite also for a triangle without area.
    """
    a, b, c = triangle[:, 0], triangle[:, 1], triangle[:, 2]
    area = doubled_area(triangle)
    area = np.where(np.abs(area) < 1e-20, 1e-20, area)
    second, third = _cross(point - a, c - a) / area, _cross(b - a, point - a) / area
    return np.stack([1 - second - third, second, third], -1)


def doubled_area(triangle: np.ndarray) -> np.ndarray:
    """Return twice the signed areas (F,) of triangles (F, 3, 2)."""
    return _cross(triangle[:, 1] - triangle[:, 0], triangle[:, 2] - triangle[:, 0])


def _cross(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Return the cross product (P,) of vectors (P, 2)."""
    return a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]


@kernel
def fill_owners(begin, end, corners, faces, owner):
    """Write the index of each triangle begin..end into the texels of `owner` (H, W) int32 whose centres it covers."""
    height, width = owner.shape
    for f in range(begin, end):
        ax, ay = corners[faces[f, 0], 0], corners[faces[f, 0], 1]
        bx, by = corners[faces[f, 1], 0], corners[faces[f, 1], 1]
        cx, cy = corners[faces[f, 2], 0], corners[faces[f, 2], 1]
        side = 1.0 if (bx - ax) * (cy - ay) - (by - ay) * (cx - ax) > 0 else -1.0
        top, bottom = max(int(min(ay, by, cy)), 0), min(int(max(ay, by, cy)) + 1, height)
        left, right = max(int(min(ax, bx, cx)), 0), min(int(max(ax, bx, cx)) + 1, width)
        for row in range(top, bottom):
            for column in range(left, right):
                x, y = column + 0.5, row + 0.5
                ab = side * ((bx - ax) * (y - ay) - (by - ay) * (x - ax))
                bc = side * ((cx - bx) * (y - by) - (cy - by) * (x - bx))
                ca = side * ((ax - cx) * (y - cy) - (ay - cy) * (x - cx))
                if ab >= 0 and bc >= 0 and ca >= 0:
                    owner[row, column] = f


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
    area = _cross(d1, d2)[:, None]
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


def add_normal_detail(normal: np.ndarray, fused: np.ndarray, seen: np.ndarray, strength: float) -> np.ndarray:
    """Turn the mesh's normals towards those fused from the views as far as the difference exceeds its noise.

    Smooth parts stay smooth, and creases that smoothing removed return.

    Args:
        normal: (P, 3) unit normals of the mesh.
        fused: (P, 3) unit normals fused from the views.
        seen: (P,) bool, points that some view sees; the median of the sine between both normals over them measures the noise.
        strength: factor of the difference beyond the noise, 0..1.

    Returns:
        (P, 3) unit normals.
    """
    difference = _perpendicular(fused, normal)
    sine = np.linalg.norm(difference, axis=-1, keepdims=True)
    noise = NOISE_RATIO * np.median(sine[seen]) if seen.any() else 0.0
    turn = np.clip(sine - noise, 0, MAX_NORMAL_SINE)
    along = difference / np.maximum(sine, 1e-9) * strength * turn
    return unit(normal * np.sqrt(1 - (strength * turn) ** 2) + along)
