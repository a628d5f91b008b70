# SPDX-License-Identifier: GPL-3.0-or-later
"""Bare surface of an object: triangles and smooth normals, before materials and textures are baked."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np


@dataclass(frozen=True, eq=False)
class Surface:
    """Triangle mesh in the world, without materials.

    Attributes:
        vertices: (V, 3) float64.
        normals: (V, 3) float64 unit, outward.
        faces: (F, 3), counter-clockwise seen from outside.
        voxel: side of a cell of the grid that the surface was extracted from, in world units: its resolution.
    """

    vertices: np.ndarray
    normals: np.ndarray
    faces: np.ndarray
    voxel: float

    @classmethod
    def restored(cls, state: dict[str, Any]) -> Surface:
        """Restore the surface from its `state`, whose arrays may have become tensors.

        Raises:
            ValueError: if the values are not those of a surface.
            KeyError: if a value is missing.
            TypeError: if a value has another type.
        """
        vertices, normals, faces = (np.asarray(state[name]) for name in ("vertices", "normals", "faces"))
        numbers = vertices.dtype.kind == normals.dtype.kind == "f" and faces.dtype.kind == "i"
        shapes = vertices.shape == normals.shape == (len(vertices), 3) and faces.shape == (len(faces), 3)
        if not numbers or not shapes or not faces.size or faces.min() < 0 or faces.max() >= len(vertices):  # kernels don't check them
            raise ValueError(f"not a surface: {vertices.dtype} {vertices.shape}, {normals.shape}, {faces.dtype} {faces.shape}")
        voxel = float(state["voxel"])
        if not np.isfinite(vertices).all() or not np.isfinite(normals).all() or not 0 < voxel < np.inf:
            raise ValueError("a surface with values that are not finite")
        return cls(vertices, normals, faces, voxel)

    def state(self) -> dict[str, Any]:
        """Return all values by name, for a checkpoint."""
        return {"vertices": self.vertices, "normals": self.normals, "faces": self.faces, "voxel": self.voxel}

    def areas(self) -> np.ndarray:
        """Return the areas (F,) of the faces."""
        corners = self.vertices[self.faces]
        return 0.5 * np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)

    def samples(self, count: int, random: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
        """Draw points uniformly by area.

        Args:
            count: number of points.
            random: generator of the draws.

        Returns:
            Points (count, 3) and their unit normals (count, 3), float32.
        """
        corners = self.vertices[self.faces]
        pick, weight = draw_on_triangles(self.areas(), count, random)
        normal = (self.normals[self.faces[pick]] * weight).sum(1)
        normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-12)
        return (corners[pick] * weight).sum(1).astype(np.float32), normal.astype(np.float32)


def draw_on_triangles(area: np.ndarray, count: int, random: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """Draw points uniformly by area on triangles.

    Args:
        area: (F,) areas of the triangles >= 0, not all 0, in any unit.
        count: number of points.
        random: generator of the draws.

    Returns:
        The triangle of each point (count,), and the weights of its three corners (count, 3, 1), >= 0 with sum 1.
    """
    pick = random.choice(len(area), count, p=area / area.sum())
    r, s = np.sqrt(random.random(count)), random.random(count)
    return pick, np.stack([1 - r, r * (1 - s), r * s], 1)[..., None]
