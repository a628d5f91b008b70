# SPDX-License-Identifier: GPL-3.0-or-later
"""Texels of a mesh in a compact form: 16 bytes for each, so that a texture of 4096 texels takes 200 MB."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy import ndimage

from ..kernels.cpu.jit import kernel

CHUNK = 1 << 20  # texels whose coordinates are computed at a time


@dataclass(frozen=True, eq=False)
class CoveredTexels:
    """P texels of a texture that lie on a mesh.

    Attributes:
        size: texels along a side of the texture.
        index: (P,) int32 flat index in the image, ascending; rows count from the image's top.
    """

    size: int
    index: np.ndarray

    def image(self, values: np.ndarray) -> np.ndarray:
        """Make an image (size, size, ...) of texel values (P, ...); texels outside all triangles take the nearest value."""
        image = np.zeros((self.size * self.size, *values.shape[1:]), values.dtype)
        image[self.index] = values
        return image[self._nearest].reshape(self.size, self.size, *values.shape[1:])

    @cached_property
    def _nearest(self) -> np.ndarray:
        """For each pixel of the image, the flat index of the nearest texel, (size * size,) int32."""
        outside = np.ones(self.size * self.size, bool)
        outside[self.index] = False
        shape = self.size, self.size
        row, column = np.asarray(ndimage.distance_transform_edt(outside.reshape(shape), return_distances=False, return_indices=True))
        return (row * np.int32(self.size) + column).ravel()


@dataclass(frozen=True, eq=False)
class MeshTexels(CoveredTexels):
    """P texels whose centre lies in a triangle of a mesh, with their places on it.

    Attributes:
        face: (P,) int32 triangle.
        barycentric: (P, 2) float32 weights of its second and third corner.
        side: (F,) float32 side of a texel on each triangle, world units.
    """

    face: np.ndarray
    barycentric: np.ndarray
    side: np.ndarray

    def chunks(self) -> Iterator[slice]:
        """Yield parts of the texels, so that intermediate values of all of them are never in memory at once."""
        for begin in range(0, len(self.index), CHUNK):
            yield slice(begin, min(begin + CHUNK, len(self.index)))

    def weights(self, part: slice = slice(None)) -> np.ndarray:
        """Return the barycentric coordinates (Q, 3) float64 of a part of the texels, of sum 1."""
        second, third = self.barycentric[part].astype(np.float64).T
        return np.stack([1 - second - third, second, third], -1)

    def interpolate(self, values: np.ndarray, faces: np.ndarray, part: slice = slice(None)) -> np.ndarray:
        """Interpolate vertex values at a part of the texels.

        Args:
            values: (V, C) at the vertices.
            faces: (F, 3) vertices of the triangles.
            part: Q of the texels.

        Returns:
            (Q, C) float64.
        """
        return np.einsum("qkc,qk->qc", values[faces[self.face[part]]], self.weights(part))

    def interpolated(self, values: np.ndarray, faces: np.ndarray) -> np.ndarray:
        """Interpolate vertex values (V, C) at all texels, (P, C) float32."""
        result = np.empty((len(self.index), values.shape[1]), np.float32)
        for part in self.chunks():
            result[part] = self.interpolate(values, faces, part)
        return result


def mesh_texels(vertices: np.ndarray, uvs: np.ndarray, faces: np.ndarray, size: int) -> MeshTexels:
    """Find the texels of a mesh.

    Args:
        vertices: (V, 3).
        uvs: (V, 2) in 0..1; v = 0 is the bottom of the image.
        faces: (F, 3).
        size: texels along a side of the texture.
    """
    corners, owner = texel_owners(uvs, faces, size)
    index = np.flatnonzero(owner.ravel() >= 0).astype(np.int32)
    face = owner.ravel()[index]
    weights = np.empty((len(index), 2), np.float32)
    for begin in range(0, len(index), CHUNK):
        part = slice(begin, begin + CHUNK)
        point = np.stack([index[part] % size + 0.5, index[part] // size + 0.5], -1)
        weights[part] = np.clip(barycentric(corners[faces[face[part]]], point)[:, 1:], 0, 1)
    return MeshTexels(size, index, face, weights, texel_sides(vertices, uvs, faces, size))


def texel_sides(vertices: np.ndarray, uvs: np.ndarray, faces: np.ndarray, size: int) -> np.ndarray:
    """Return the side (F,) float32 of a texel on each triangle, world units; 0 for a triangle without area.

    Args:
        vertices: (V, 3).
        uvs: (V, 2) in 0..1.
        faces: (F, 3).
        size: texels along a side of the texture.
    """
    flat = np.abs(doubled_area(_texel_corners(uvs, size)[faces]))
    return np.sqrt(_doubled_world_area(vertices, faces) / np.maximum(flat, 1e-12)).astype(np.float32)


def _texel_corners(uvs: np.ndarray, size: int) -> np.ndarray:
    """Return UVs (V, 2) as column and row in texels, float64, with texel centres at .5."""
    corners = uvs.astype(np.float64) * size
    corners[:, 1] = size - corners[:, 1]
    return corners


def texel_owners(uvs: np.ndarray, faces: np.ndarray, size: int) -> tuple[np.ndarray, np.ndarray]:
    """Find the triangle over each texel's centre; where several are, the last one.

    Args:
        uvs: (V, 2) in 0..1; v = 0 is the bottom of the image.
        faces: (F, 3) vertices of the triangles.
        size: texels along a side of the texture.

    Returns:
        The vertices (V, 2) float64 as column and row, with texel centres at .5, and the triangles (size, size) int32, -1 where none is.
    """
    corners = _texel_corners(uvs, size)
    owner = np.full((size, size), -1, np.int32)
    fill_owners(0, len(faces), corners, faces, owner)
    return corners, owner


def mean_texel_side(vertices: np.ndarray, faces: np.ndarray, uvs: np.ndarray, size: int) -> float:
    """Return the mean side of a texel on a surface, world units: the root of the surface's area over the texels that cover it.

    Args:
        vertices: (V, 3) world.
        faces: (F, 3).
        uvs: (V, 2) in 0..1.
        size: texels along a side of the texture.
    """
    area = 2 * surface_area(vertices, faces)
    texels = np.abs(doubled_area(uvs[faces].astype(np.float64))).sum() * size**2
    return float(np.sqrt(area / max(texels, 1e-12)))


def surface_area(vertices: np.ndarray, faces: np.ndarray) -> float:
    """Return the area of a surface, world units squared.

    Args:
        vertices: (V, 3) world.
        faces: (F, 3).
    """
    return float(_doubled_world_area(vertices, faces).sum()) / 2


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
    second, third = flat_cross(point - a, c - a) / area, flat_cross(b - a, point - a) / area
    return np.stack([1 - second - third, second, third], -1)


def doubled_area(triangle: np.ndarray) -> np.ndarray:
    """Return twice the signed areas (F,) of triangles (F, 3, 2)."""
    return flat_cross(triangle[:, 1] - triangle[:, 0], triangle[:, 2] - triangle[:, 0])


def _doubled_world_area(vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """Return twice the areas (F,) of the faces (F, 3) of vertices (V, 3) in space."""
    corners = vertices[faces].astype(np.float64)
    return np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=-1)


def flat_cross(a: np.ndarray, b: np.ndarray) -> np.ndarray:
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
