# SPDX-License-Identifier: GPL-3.0-or-later
"""Mesh as a PLY file, which other viewers open too."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from plyfile import PlyData, PlyElement, PlyParseError

from ..errors import InputError
from ..io.atomic import atomic_file
from ..io.srgb import encode_srgb
from .gbuffer import CONFIDENCE
from .mesh import Mesh, joined_quads

COLUMNS = {
    "vertices": ("x", "y", "z"),
    "normals": ("nx", "ny", "nz"),
    "uvs": ("s", "t"),
    "albedo": ("albedo_r", "albedo_g", "albedo_b"),
    "roughness": ("roughness",),
    "metallic": ("metallic",),
}
OPTIONAL = {"confidence": ("confidence",), "material_confidence": CONFIDENCE}
QUAD = "quad"  # property of faces: 1 where this triangle and the next one make up a quad
COLOUR = ("red", "green", "blue")  # the albedo once more, 8-bit sRGB, for viewers that don't know the columns above


def save_mesh_ply(mesh: Mesh, path: Path) -> None:
    """Write geometry, UVs and vertex materials (not the textures) as a binary PLY, atomically.

    Args:
        mesh: the mesh.
        path: the PLY to write.
    """
    columns = COLUMNS | {field: names for field, names in OPTIONAL.items() if getattr(mesh, field) is not None}
    floats = [(name, "f4") for names in columns.values() for name in names]
    vertex = np.empty(len(mesh.vertices), [*floats, *((name, "u1") for name in COLOUR)])
    for field, names in columns.items():
        values = getattr(mesh, field).reshape(len(vertex), len(names))
        for i, name in enumerate(names):
            vertex[name] = values[:, i]
    colour = np.round(255 * np.clip(encode_srgb(np.clip(mesh.albedo, 0, 1)), 0, 1))
    for i, name in enumerate(COLOUR):
        vertex[name] = colour[:, i]
    flags = [] if mesh.quads is None else [(QUAD, "u1")]
    face = np.empty(len(mesh.faces), [("vertex_indices", "i4", (3,)), *flags])
    face["vertex_indices"] = mesh.faces
    if mesh.quads is not None:
        face[QUAD] = mesh.quads
    with atomic_file(path) as partial:
        PlyData([PlyElement.describe(vertex, "vertex"), PlyElement.describe(face, "face")], byte_order="<").write(str(partial))


def load_mesh_ply(path: Path) -> Mesh:
    """Read the mesh that `save_mesh_ply` wrote; its textures are empty.

    Raises:
        InputError: if the file is missing or broken, or lacks an element or a column.
    """
    ply = read_ply(path)
    for name in ("vertex", "face"):
        if name not in ply:
            raise InputError(path, f"has no {name} element")
    vertex, face = ply["vertex"].data, ply["face"].data
    missing = [name for names in COLUMNS.values() for name in names if name not in (vertex.dtype.names or ())]
    if missing:
        raise InputError(path, f"its vertices lack {', '.join(missing)}", "give the mesh.ply of a run folder")
    columns = COLUMNS | {field: names for field, names in OPTIONAL.items() if set(names) <= set(vertex.dtype.names)}
    values = {field: np.stack([vertex[name] for name in names], -1).astype(np.float32) for field, names in columns.items()}
    if not all(np.isfinite(value).all() for value in values.values()):
        raise InputError(path, "has vertices that are not finite")
    faces = triangles_of(face, path)
    if len(faces) and (faces.min() < 0 or faces.max() >= len(vertex)):
        raise InputError(path, f"has faces that refer to vertices beyond the {len(vertex)} of the file")
    scalars = {field: values.pop(field)[:, 0] for field in ("roughness", "metallic", "confidence") if field in values}
    quads = joined_quads(faces, face[QUAD].astype(bool) if QUAD in face.dtype.names else None)
    return Mesh(**values, **scalars, faces=faces, quads=quads)  # pyright: ignore[reportArgumentType]


def read_ply(path: Path) -> PlyData:
    """Read a PLY of triangles; raise InputError where the file is missing or broken."""
    try:
        return PlyData.read(str(path), mmap="c", known_list_len={"face": {"vertex_indices": 3}})
    except FileNotFoundError as error:
        raise InputError(path, "no such file") from error
    except (OSError, PlyParseError, ValueError, MemoryError, UnicodeDecodeError) as error:
        raise InputError(path, f"not a readable PLY of triangles ({error})") from error


def triangles_of(face: np.ndarray, path: Path) -> np.ndarray:
    """Return the triangles (F, 3) int32 of a PLY's faces; raise InputError where there are other polygons."""
    if "vertex_indices" not in (face.dtype.names or ()):
        raise InputError(path, "its faces lack vertex_indices")
    indices = face["vertex_indices"]
    if indices.dtype == object and len({len(i) for i in indices}) == 1:  # plyfile reads the faces of a PLY in ASCII as lists
        indices = np.array(indices.tolist())
    if indices.ndim != 2 or indices.shape[1] != 3:
        raise InputError(path, "has faces that are not triangles")
    return indices.astype(np.int32)
