# SPDX-License-Identifier: GPL-3.0-or-later
"""Bare surface as a PLY file, which other programs open too."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from plyfile import PlyData, PlyElement

from ..errors import InputError
from ..io.atomic import atomic_file
from .mesh_ply import read_ply, triangles_of
from .surface import Surface

PLACE, NORMAL = ("x", "y", "z"), ("nx", "ny", "nz")
VOXEL = "voxel"  # line "obj_info voxel SIDE" of the header


def save_surface_ply(surface: Surface | None, path: Path) -> None:
    """Write a surface as a binary PLY, atomically, with float32 coordinates.

    Args:
        surface: the surface; None: remove the file of an earlier one.
        path: the PLY to write.
    """
    if surface is None:
        path.unlink(missing_ok=True)
        return
    vertex = np.empty(len(surface.vertices), [(name, "f4") for name in PLACE + NORMAL])
    for i in range(3):
        vertex[PLACE[i]], vertex[NORMAL[i]] = surface.vertices[:, i], surface.normals[:, i]
    face = np.empty(len(surface.faces), [("vertex_indices", "i4", (3,))])
    face["vertex_indices"] = surface.faces
    elements = [PlyElement.describe(vertex, "vertex"), PlyElement.describe(face, "face")]
    with atomic_file(path) as partial:
        PlyData(elements, byte_order="<", obj_info=[f"{VOXEL} {surface.voxel!r}"]).write(str(partial))


def load_surface_ply(path: Path) -> Surface | None:
    """Read the surface that `save_surface_ply` wrote; return None where there is no file.

    Raises:
        InputError: if the file is broken, or lacks an element or a column.
    """
    if not path.is_file():
        return None
    data = read_ply(path)
    try:
        vertex, faces = data["vertex"].data, triangles_of(data["face"].data, path)
        places, normals = (np.stack([vertex[name] for name in names], 1).astype(np.float64) for names in (PLACE, NORMAL))
        sides = [float(line.split()[1]) for line in data.obj_info if line.startswith(VOXEL + " ")]
        return Surface.restored({"vertices": places, "normals": normals, "faces": faces, "voxel": sides[0]})
    except (KeyError, ValueError, IndexError) as error:
        raise InputError(path, f"is not the surface of a run ({error})") from error
