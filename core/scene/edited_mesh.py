# SPDX-License-Identifier: GPL-3.0-or-later
"""Mesh edited in a modelling program: a PLY of any polygons, with or without UVs and normals."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from plyfile import PlyData, PlyParseError

from ..errors import InputError
from .mesh import joined_quads
from .mesh_ply import QUAD
from .udim import MOST_TILES, tile_number

SLACK = 1e-4  # by which UVs may lie outside
UV_NAMES = (("s", "t"), ("u", "v"), ("texture_u", "texture_v"))  # as Blender and others write them


@dataclass(frozen=True, eq=False)
class EditedMesh:
    """Triangle mesh in the world of a run.

    Attributes:
        vertices: (V, 3) float64.
        faces: (F, 3) int64, counter-clockwise seen from outside.
        uvs: (V, 2) float32 in 0..1 over all tiles, v = 0 at the bottom, or None.
        normals: (V, 3) float64 unit, or None.
        quads: (F,) bool, which triangles make up quads, as in `Mesh.quads`; None without any.
        tiles: UDIM tiles along a side, which hold the UVs; 1 without UVs.
    """

    vertices: np.ndarray
    faces: np.ndarray
    uvs: np.ndarray | None
    normals: np.ndarray | None
    quads: np.ndarray | None = None
    tiles: int = 1


def load_edited_mesh(path: Path) -> EditedMesh:
    """Read a PLY; polygons are split into triangles, and vertices with equal position, UV and normal are merged.

    UVs beyond 1 lie in UDIM tiles: u and v up to 2 in 2 x 2 tiles, and so on.

    Raises:
        InputError: if the file is missing or broken, has no faces, or has UVs outside of 0..4.
    """
    vertex, polygons, flags = _read(path)
    names = vertex.dtype.names or ()
    position = _columns(vertex, ("x", "y", "z"), path)
    uv_names = next((pair for pair in UV_NAMES if set(pair) <= set(names)), None)
    parts, tiles = [position], 1
    if uv_names:
        uvs = _columns(vertex, uv_names, path)
        if uvs.min() < -SLACK or uvs.max() > MOST_TILES + SLACK:
            fix = f"unwrap it into one square, or into UDIM tiles up to {tile_number(MOST_TILES - 1, MOST_TILES - 1)}"
            raise InputError(path, f"has UVs outside of 0..{MOST_TILES}", fix)
        tiles = max(1, math.ceil(uvs.max() - SLACK))
        parts.append(np.clip(uvs / tiles, 0, 1))
    if {"nx", "ny", "nz"} <= set(names):
        parts.append(_columns(vertex, ("nx", "ny", "nz"), path))
    faces, quads = _triangles(polygons, len(vertex), path)
    quads = quads if flags is None else flags
    # A program that writes each face's corners separately leaves the faces unconnected: merge equal vertices.
    rows, welded = np.unique(np.concatenate(parts, -1).astype(np.float32), axis=0, return_inverse=True)
    faces = welded.reshape(-1)[faces]
    keep = (faces[:, 0] != faces[:, 1]) & (faces[:, 1] != faces[:, 2]) & (faces[:, 2] != faces[:, 0])
    faces, quads = faces[keep], quads[keep]
    if not len(faces):
        raise InputError(path, "has no faces")
    used, faces = np.unique(faces, return_inverse=True)
    columns = np.split(rows[used], np.cumsum([part.shape[1] for part in parts])[:-1], axis=1)
    normals = _unit(columns[-1]) if len(parts) == 2 + bool(uv_names) else None
    faces = faces.reshape(-1, 3)
    return EditedMesh(columns[0].astype(np.float64), faces, columns[1] if uv_names else None, normals, joined_quads(faces, quads), tiles)


def _read(path: Path) -> tuple[np.ndarray, np.ndarray, np.ndarray | None]:
    """Return vertices, polygons, and where all are triangles, those that are marked as halves of quads."""
    try:
        ply = PlyData.read(str(path))
        face = ply["face"].data
        index = next(name for name in ("vertex_indices", "vertex_index") if name in (face.dtype.names or ()))
        marked = QUAD in face.dtype.names and all(len(polygon) == 3 for polygon in face[index])
        return ply["vertex"].data, face[index], face[QUAD].astype(bool) if marked else None
    except FileNotFoundError as error:
        raise InputError(path, "no such file") from error
    except (OSError, PlyParseError, ValueError, MemoryError, UnicodeDecodeError, KeyError, StopIteration) as error:
        raise InputError(path, f"not a readable PLY with vertices and faces ({error or 'no vertex indices'})") from error


def _columns(vertex: np.ndarray, names: tuple[str, ...], path: Path) -> np.ndarray:
    if missing := [name for name in names if name not in (vertex.dtype.names or ())]:
        raise InputError(path, f"its vertices lack {', '.join(missing)}")
    values = np.stack([vertex[name] for name in names], -1).astype(np.float64)
    if not len(values) or not np.isfinite(values).all():
        raise InputError(path, "has no vertices, or vertices that are not finite")
    return values


def _triangles(polygons: np.ndarray, vertices: int, path: Path) -> tuple[np.ndarray, np.ndarray]:
    """Return the polygons split into fans of triangles (F, 3), and which of these make up quads (F,) bool."""
    by_corners: dict[int, list[np.ndarray]] = {}
    for polygon in polygons:
        by_corners.setdefault(len(polygon), []).append(np.asarray(polygon, np.int64))
    fans, quads = [np.empty((0, 3), np.int64)], [np.empty(0, bool)]
    for corners, same in by_corners.items():
        p = np.stack(same)
        fan = [np.stack([p[:, 0], p[:, k], p[:, k + 1]], -1) for k in range(1, corners - 1)]
        if fan:
            fans.append(np.stack(fan, 1).reshape(-1, 3))  # the triangles of a polygon follow one another
            quads.append(np.arange(len(fans[-1])) % 2 == 0 if corners == 4 else np.zeros(len(fans[-1]), bool))
    faces = np.concatenate(fans)
    if len(faces) and (faces.min() < 0 or faces.max() >= vertices):
        raise InputError(path, f"has faces that refer to vertices beyond the {vertices} of the file")
    return faces, np.concatenate(quads)


def _unit(normals: np.ndarray) -> np.ndarray | None:
    """Normalise normals (V, 3); return None if one of them has length zero, since its direction is unknown."""
    length = np.linalg.norm(normals.astype(np.float64), axis=-1, keepdims=True)
    return normals / length if (length > 1e-6).all() else None
