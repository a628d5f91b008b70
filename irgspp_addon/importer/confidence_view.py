# SPDX-License-Identifier: GPL-3.0-or-later
"""View of the confidence: the material glows in the confidence of albedo (red), roughness (green) and metallic (blue).

White is where all three are well known.
"""

from __future__ import annotations

import bpy
from bpy.props import BoolProperty

from ..shared_properties import SHOW_CONFIDENCE
from .materials import principled_of

ATTRIBUTE = "material_confidence"  # colour attribute of the mesh
EMISSION = "confidence"  # name of the node
PLACE = (50, -900)  # of the nodes in the editor


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
    """Return True where the material has the nodes that show the confidence, and an output."""
    return material.node_tree is not None and EMISSION in material.node_tree.nodes and _output(material) is not None


def confidence_shown(material: bpy.types.Material) -> bool:
    """Return True where the material shows the confidence instead of reflecting light."""
    output = _output(material) if has_confidence(material) else None
    links = output.inputs["Surface"].links if output is not None else ()
    return bool(links) and links[0].from_node.name == EMISSION


def show_confidence(material: bpy.types.Material, shown: bool) -> None:
    """Let the material show the confidence, or reflect light again; nothing changes where it has no nodes for that.

    Args:
        material: to change.
        shown: show the confidence.
    """
    tree, output = material.node_tree, _output(material)
    if tree is None or output is None or not has_confidence(material):
        return
    node = tree.nodes[EMISSION] if shown else principled_of(material)
    if node is not None:
        tree.links.new(node.outputs[0], output.inputs["Surface"])


def _output(material: bpy.types.Material) -> bpy.types.Node | None:
    """Return the material's output node; None where the user has removed it."""
    nodes = material.node_tree.nodes if material.node_tree else ()
    return next((node for node in nodes if node.bl_idname == "ShaderNodeOutputMaterial"), None)


def register() -> None:
    """Add the property `material.irgspp_show_confidence`, which stores nothing: it reads and changes the link to the output."""
    bpy.types.Material.irgspp_show_confidence = BoolProperty(**SHOW_CONFIDENCE, get=confidence_shown, set=show_confidence)


def unregister() -> None:
    """Remove the property `material.irgspp_show_confidence`."""
    del bpy.types.Material.irgspp_show_confidence
