# SPDX-License-Identifier: GPL-3.0-or-later
"""Reader and writer of binary PLY files with numpy alone: Blender's own importer does not keep all attributes."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np

from ...core.errors import InputError

TYPES = {
    "char": "i1", "int8": "i1", "uchar": "u1", "uint8": "u1", "short": "i2", "int16": "i2", "ushort": "u2", "uint16": "u2",
    "int": "i4", "int32": "i4", "uint": "u4", "uint32": "u4", "float": "f4", "float32": "f4", "double": "f8", "float64": "f8",
}  # fmt: skip


def read_ply(path: Path) -> dict[str, np.ndarray]:
    """Read a binary little-endian PLY whose lists all have three values (triangles).

    Returns:
        Structured arrays by the elements' names; a list property is a field of shape (3,).

    Raises:
        InputError: if the file can't be read, is damaged, or has other lists.
    """
    try:
        data = path.read_bytes()
    except OSError as error:
        raise InputError(path, f"can't be read ({error.strerror})") from error
    head, mark, _ = data.partition(b"end_header\n")
    if not data.startswith(b"ply") or not mark or b"format binary_little_endian" not in head:
        raise InputError(path, "is not a binary little-endian PLY")
    offset, elements = len(head) + len(mark), {}
    for name, count, fields in _elements(head.decode("ascii", "replace"), path):
        layout = np.dtype(fields)
        if offset + count * layout.itemsize > len(data):
            raise InputError(path, "is truncated")
        elements[name] = np.frombuffer(data, layout, count, offset)
        if any((elements[name][field] != 3).any() for field in layout.names or () if field.startswith("count of ")):
            raise InputError(path, f"element {name} has a list whose length is not 3")
        offset += count * layout.itemsize
    return elements


def _elements(head: str, path: Path) -> list[tuple[str, int, list[tuple]]]:
    """Return name, count and numpy fields of each element in a PLY header."""
    elements: list[tuple[str, int, list[tuple]]] = []
    try:
        for words in map(str.split, head.splitlines()):
            if words[:1] == ["element"]:
                elements.append((words[1], int(words[2]), []))
            elif words[:2] == ["property", "list"]:
                elements[-1][2].extend([(f"count of {words[4]}", "<" + TYPES[words[2]]), (words[4], "<" + TYPES[words[3]], 3)])
            elif words[:1] == ["property"]:
                elements[-1][2].append((words[2], "<" + TYPES[words[1]]))
    except (IndexError, KeyError, ValueError) as error:
        raise InputError(path, f"has a broken header ({error!r})") from error
    return elements


def write_ply(path: Path, vertices: np.ndarray, faces: np.ndarray, normals: np.ndarray, uvs: np.ndarray | None, quads: np.ndarray) -> None:
    """Write a triangle mesh as a binary PLY, atomically.

    Args:
        path: file to write.
        vertices: (V, 3) positions.
        faces: (F, 3) vertex indices of the triangles.
        normals: (V, 3) unit normals.
        uvs: (V, 2) texture coordinates, or None.
        quads: (F,) bool, True for a triangle that makes up a quad with the next one.

    Raises:
        InputError: if the file can't be written.
    """
    columns = {"x": vertices[:, 0], "y": vertices[:, 1], "z": vertices[:, 2], "nx": normals[:, 0], "ny": normals[:, 1], "nz": normals[:, 2]}
    if uvs is not None:
        columns |= {"s": uvs[:, 0], "t": uvs[:, 1]}
    lines = ["ply", "format binary_little_endian 1.0", f"element vertex {len(vertices)}", *(f"property float {name}" for name in columns)]
    lines += [f"element face {len(faces)}", "property list uchar int vertex_indices", "property uchar quad", "end_header", ""]
    face = np.empty(len(faces), [("count", "u1"), ("corners", "<i4", 3), ("quad", "u1")])
    face["count"], face["corners"], face["quad"] = 3, faces, quads
    partial = path.with_name(path.name + ".part")
    try:
        partial.write_bytes("\n".join(lines).encode() + np.stack([*columns.values()], -1).astype("<f4").tobytes() + face.tobytes())
        os.replace(partial, path)
    except OSError as error:
        raise InputError(path, f"can't be written ({error.strerror})") from error
