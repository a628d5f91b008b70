# SPDX-License-Identifier: GPL-3.0-or-later
"""Export of a mesh that the user has edited or modelled, for the engine to bake textures onto."""

from __future__ import annotations

import hashlib
from pathlib import Path

import bpy
import numpy as np
from mathutils import Matrix

from ...core.errors import InputError
from ..user_folder import user_folder
from .ply import write_ply
from .run_root import RUN, find_roots


def save_edited(context: bpy.types.Context, thing: bpy.types.Object, run: Path) -> Path:
    """Write a mesh object, with its modifiers applied, as a PLY file in the run's frame.

    Args:
        context: Blender's context.
        thing: mesh object.
        run: run folder.

    Returns:
        Path of the file.

    Raises:
        InputError: if the object is not a mesh or has no faces.
    """
    if thing.type != "MESH":
        raise InputError(thing.name, "is not a mesh", "choose a mesh object")
    if thing.mode == "EDIT":
        thing.update_from_editmode()
    root = next((root for root in find_roots(context.scene, RUN) if Path(root[RUN]) == run.resolve()), None)
    context.view_layer.update()
    to_run = (root.matrix_world.inverted() if root else Matrix()) @ thing.matrix_world
    digest = hashlib.sha1(str(run.resolve()).encode(), usedforsecurity=False).hexdigest()[:12]
    path = user_folder("edited") / f"{digest}.ply"
    evaluated = thing.evaluated_get(context.evaluated_depsgraph_get())
    try:
        write_mesh(path, evaluated.to_mesh(), np.array(to_run), thing.name)
    finally:
        evaluated.to_mesh_clear()
    return path


def write_mesh(path: Path, mesh: bpy.types.Mesh, to_run: np.ndarray, name: str) -> None:
    """Write a mesh as triangles, of which those that make up quads are marked.

    Args:
        path: PLY to write.
        mesh: Blender's mesh.
        to_run: (4, 4) from the mesh's frame to the run's.
        name: of the object, for messages.

    Raises:
        InputError: if the mesh has no faces, or the file can't be written.
    """
    mesh.calc_loop_triangles()
    if not len(mesh.loop_triangles):
        raise InputError(name, "has no faces")
    loops, quads = _triangles(mesh)
    if np.linalg.det(to_run[:3, :3]) < 0:  # else a mirrored object would be inside out
        loops = loops[:, ::-1]
        second = np.roll(
            quads, 1
        )  # of a quad (a, b, c, d), whose halves are (c, b, a) and (d, c, a) now: (c, a, d) is that of (c, b, a, d)
        loops = np.where(second[:, None], np.roll(loops, -1, axis=1), loops)
    corners = loops.reshape(-1)
    vertex_of = _values(mesh.loops, "vertex_index", 1, np.int32)[:, 0]
    position = _values(mesh.vertices, "co", 3)[vertex_of[corners]] @ to_run[:3, :3].T + to_run[:3, 3]
    normal = _values(mesh.corner_normals, "vector", 3)[corners] @ np.linalg.inv(to_run[:3, :3])
    normal /= np.maximum(np.linalg.norm(normal, axis=-1, keepdims=True), 1e-12)
    layer = mesh.uv_layers.active
    uvs = _values(layer.uv, "vector", 2)[corners] if layer else None
    write_ply(path, position, np.arange(len(corners)).reshape(-1, 3), normal, uvs, quads)


def _triangles(mesh: bpy.types.Mesh) -> tuple[np.ndarray, np.ndarray]:
    """Return the corners of Blender's triangles (F, 3), and which of them make up quads (F,) bool, as in `core.scene.mesh.Mesh`."""
    loops, polygon = _values(mesh.loop_triangles, "loops", 3, np.int32), _values(mesh.loop_triangles, "polygon_index", 1, np.int32)[:, 0]
    start, corners = (_values(mesh.polygons, name, 1, np.int32)[polygon, 0] for name in ("loop_start", "loop_total"))
    quads = (corners == 4) & np.append(polygon[1:] == polygon[:-1], False)
    first = np.flatnonzero(quads)
    last = 6 - (loops[first] - start[first][:, None]).sum(-1)  # the corner that the first triangle leaves out
    a, b, c, d = (start[first] + (last + k) % 4 for k in (1, 2, 3, 4))
    loops[first], loops[first + 1] = np.stack([a, b, c], -1), np.stack([a, c, d], -1)
    return loops, quads


def _values(collection, attribute: str, width: int, kind: type = np.float32) -> np.ndarray:
    values = np.empty(width * len(collection), kind)
    collection.foreach_get(attribute, values)
    return values.reshape(-1, width)
