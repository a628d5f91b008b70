# SPDX-License-Identifier: GPL-3.0-or-later
"""Words of the panels about a mesh and its textures."""

from __future__ import annotations

import bpy

from ..irgspp_addon.translations import translated


def size_text(size: int) -> str:
    """Return a texture size as artists name it: "2k" for 2048 texels along a side."""
    return f"{size // 1024}k" if size % 1024 == 0 else str(size)


def mesh_text(triangles: int, quads: int, edited: bool) -> str:
    """Return what baking does with the mesh, in words.

    Args:
        triangles: largest number of triangles; 0 keeps the mesh.
        quads: approximate number of quads; 0 for none.
        edited: the user has chosen a mesh of their own.
    """
    if edited:
        return "The edited mesh is baked as it is."
    if quads:
        return translated("The mesh is remeshed to about {count} quads.", count=f"{quads:,}")
    if not triangles:
        return "0 triangles: the mesh stays as it is."
    return translated("A new mesh of at most {count} triangles.", count=f"{triangles:,}")


def faces_text(mesh: bpy.types.Mesh) -> str:
    """Return the number of faces, such as "5,000 triangles" or, where there are others too, "2,000 faces"."""
    count = len(mesh.polygons)
    return translated("{count} triangles" if len(mesh.loops) == 3 * count else "{count} faces", count=f"{count:,}")


def texture_text(thing: bpy.types.Object) -> str:
    """Return the size of the material's textures, such as "textures 1024", or "textures 4 x 1024" where they have four UDIM tiles."""
    tree = thing.active_material.node_tree if thing.active_material else None
    images = [node.image for node in tree.nodes if node.bl_idname == "ShaderNodeTexImage" and node.image] if tree else []
    if not images:
        return translated("no textures")
    size, tiles = images[0].size[0], len(images[0].tiles) if images[0].source == "TILED" else 1
    return translated("textures {size}", size=size if tiles == 1 else f"{tiles} x {size}")
