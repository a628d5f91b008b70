# SPDX-License-Identifier: GPL-3.0-or-later
"""Parts of a production asset as Blender objects: levels of detail that share the textures, and collision hulls."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import bpy
import numpy as np
from mathutils import Vector
from mathutils.kdtree import KDTree

from ...core.scene.similarity import moved_points

NEAREST = 6  # vertices of the full mesh among which a decimated vertex looks for the normal of its own side
HULL = "UCX_"  # by which Unreal Engine knows a collision hull
MOST_HULLS = 100  # the number in a hull's name has two digits


def add_levels(full: bpy.types.Object, ratios: Sequence[float], name: str) -> list[bpy.types.Object]:
    """Name the object NAME_LOD0 and add decimated copies NAME_LOD1 and so on, with its material, parent and collections.

    UV seams survive: Blender's Decimate modifier collapses no edge across them.

    Args:
        full: mesh object with its UV map.
        ratios: fraction of the triangles in each further level.
        name: of the asset.
    """
    full.name = full.data.name = f"{name}_LOD0"
    return [_level(full, ratio, f"{name}_LOD{i}") for i, ratio in enumerate(ratios, start=1)]


def _level(full: bpy.types.Object, ratio: float, name: str) -> bpy.types.Object:
    modifier = full.modifiers.new("LOD", "DECIMATE")
    modifier.ratio, modifier.use_collapse_triangulate = ratio, True
    bpy.context.view_layer.update()
    evaluated = full.evaluated_get(bpy.context.evaluated_depsgraph_get())
    mesh = bpy.data.meshes.new_from_object(evaluated, preserve_all_data_layers=True, depsgraph=bpy.context.evaluated_depsgraph_get())
    full.modifiers.remove(modifier)
    mesh.name = name
    mesh.shade_smooth()
    mesh.normals_split_custom_set_from_vertices(normals_from(full.data, mesh))
    return _placed_beside(full, mesh, name)


def _placed_beside(full: bpy.types.Object, mesh: bpy.types.Mesh, name: str) -> bpy.types.Object:
    """Make an object with the transform, the parent and the collections of another one."""
    thing = bpy.data.objects.new(name, mesh)
    for collection in full.users_collection:
        collection.objects.link(thing)
    thing.parent, thing.matrix_parent_inverse, thing.matrix_basis = full.parent, full.matrix_parent_inverse, full.matrix_basis
    return thing


def normals_from(full: bpy.types.Mesh, mesh: bpy.types.Mesh) -> list[tuple[float, float, float]]:
    """Return a normal for each vertex of a reduced mesh: that of the nearest vertex of the full mesh on the same side of the surface.

    Args:
        full: mesh whose corners at a vertex share a normal.
        mesh: reduced mesh of the same surface.
    """
    tree = KDTree(len(full.vertices))
    for i, vertex in enumerate(full.vertices):
        tree.insert(vertex.co, i)
    tree.balance()
    normals = _vertex_normals(full)
    found = []
    for vertex in mesh.vertices:
        near = [normals[i] for _, i, _ in tree.find_n(vertex.co, NEAREST)]
        normal = next((n for n in near if vertex.normal.dot(Vector(n)) > 0), vertex.normal)
        found.append(tuple(normal))
    return found


def _vertex_normals(mesh: bpy.types.Mesh) -> np.ndarray:
    """Return the shading normals (V, 3) of a mesh whose corners at a vertex share one."""
    corner = np.empty(3 * len(mesh.loops), np.float32)
    mesh.corner_normals.foreach_get("vector", corner)
    vertex = np.empty(len(mesh.loops), np.int32)
    mesh.loops.foreach_get("vertex_index", vertex)
    normals = np.zeros((len(mesh.vertices), 3), np.float32)
    normals[vertex] = corner.reshape(-1, 3)
    return normals


def hull_name(full: bpy.types.Object, number: int) -> str:
    """Return the name of a hull of an object: Unreal Engine finds hulls by the name of the mesh that they belong to.

    Args:
        full: mesh object, named.
        number: of the hull, from 0.
    """
    return f"{HULL}{full.name}_{number:02d}"


def add_hulls(full: bpy.types.Object, file: Path, matrix: np.ndarray) -> list[bpy.types.Object]:
    """Add the convex hulls of a file as objects, which game engines take as collision shapes.

    They are called UCX_NAME_00 and so on, UCX_NAME_LOD0_00 with levels of detail.

    Args:
        full: mesh object of the asset, named; the hulls get its transform, parent and collections.
        file: .npz with the arrays "vertices0" (V, 3) and "faces0" (F, 3) of the first hull, and so on.
        matrix: (4, 4) from the frame of the hulls to that of the object's mesh.
    """
    hulls = []
    with np.load(file, allow_pickle=False) as arrays:
        for i in range(min(len(arrays.files) // 2, MOST_HULLS)):
            mesh = bpy.data.meshes.new(hull_name(full, i))
            mesh.from_pydata(moved_points(arrays[f"vertices{i}"], matrix).tolist(), [], arrays[f"faces{i}"].tolist())
            hull = _placed_beside(full, mesh, mesh.name)
            hull.display_type = "WIRE"
            hulls.append(hull)
    return hulls
