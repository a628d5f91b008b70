# SPDX-License-Identifier: GPL-3.0-or-later
"""Shader nodes of Worlds, lamps and materials: whether they count, and a new beginning."""

from __future__ import annotations

import bpy


def uses_nodes(owner: bpy.types.World | bpy.types.Light | bpy.types.Material) -> bool:
    """Return True where the nodes of a World, lamp or material count: it has some, and they are not switched off.

    Later versions of Blender always use nodes; there the switch has no effect, and reading it gives a warning.
    """
    if owner.node_tree is None:
        return False
    switch = owner.bl_rna.properties.get("use_nodes")
    return switch is None or getattr(switch, "is_deprecated", False) or owner.use_nodes


def node_tree(owner: bpy.types.World | bpy.types.Material) -> tuple[bpy.types.Nodes, bpy.types.NodeLinks]:
    """Remove all shader nodes of a World or material and return its nodes and links."""
    if not uses_nodes(owner):
        owner.use_nodes = True
    tree = owner.node_tree
    assert tree is not None
    tree.nodes.clear()
    return tree.nodes, tree.links
