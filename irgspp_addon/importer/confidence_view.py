# SPDX-License-Identifier: GPL-3.0-or-later
"""View of the confidence: the material glows in the confidence of albedo (red), roughness (green) and metallic (blue).

White is where all three are well known.
"""

from __future__ import annotations

import bpy
from bpy.props import BoolProperty

from ..shared_properties import SHOW_CONFIDENCE

ATTRIBUTE = "material_confidence"  # colour attribute of the mesh
EMISSION = "confidence"  # node
PLACE = (50, -900)


def add_confidence_nodes(material: bpy.types.Material) -> None:
    """Add the nodes that show the confidence, not connected to the output yet.

    Args:
        material: of a run, with its other nodes.
    """
    assert material.node_tree is not None
    nodes = material.node_tree.nodes
    source, emission = nodes.new("ShaderNodeAttribute"), nodes.new("ShaderNodeEmission")
    source.attribute_type, source.attribute_name, source.name, source.location = "GEOMETRY", ATTRIBUTE, ATTRIBUTE, PLACE
    emission.name = emission.label = EMISSION
    emission.location = (PLACE[0] + 220, PLACE[1])
    material.node_tree.links.new(source.outputs["Color"], emission.inputs["Color"])


def has_confidence(material: bpy.types.Material) -> bool:
    """Return True where the material has the nodes that show the confidence."""
    return material.node_tree is not None and EMISSION in material.node_tree.nodes


def confidence_shown(material: bpy.types.Material) -> bool:
    """Return True where the material shows the confidence instead of reflecting light."""
    links = _surface(material).links if has_confidence(material) else ()
    return bool(links) and links[0].from_node.name == EMISSION


def show_confidence(material: bpy.types.Material, shown: bool) -> None:
    """Let the material show the confidence, or reflect light again; nothing changes where it has no nodes for that.

    Args:
        material: to change.
        shown: show the confidence.
    """
    if not has_confidence(material):
        return
    tree = material.node_tree
    assert tree is not None
    kind = "ShaderNodeEmission" if shown else "ShaderNodeBsdfPrincipled"
    node = next((node for node in tree.nodes if node.bl_idname == kind), None)
    if node is not None:
        tree.links.new(node.outputs[0], _surface(material))


def _surface(material: bpy.types.Material) -> bpy.types.NodeSocket:
    """Return the surface's input of the material's output node."""
    assert material.node_tree is not None
    return next(node for node in material.node_tree.nodes if node.bl_idname == "ShaderNodeOutputMaterial").inputs["Surface"]


def register() -> None:
    """Add the property `material.irgspp_show_confidence`, which stores nothing: it reads and changes the link to the output."""
    bpy.types.Material.irgspp_show_confidence = BoolProperty(**SHOW_CONFIDENCE, get=confidence_shown, set=show_confidence)


def unregister() -> None:
    """Remove the property `material.irgspp_show_confidence`."""
    del bpy.types.Material.irgspp_show_confidence
