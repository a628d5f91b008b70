# SPDX-License-Identifier: GPL-3.0-or-later
"""Principled material of a run: it has nodes for both the textures and the mesh's attributes, and reads one of the two."""

from __future__ import annotations

from collections.abc import Mapping

import bpy
from bpy.props import EnumProperty

from ...core.errors import InputError
from ..shared_properties import SOURCE
from ..world.shader_nodes import node_tree
from .displacement import Heights, add_displacement

TEXTURES = ("albedo", "roughness", "metallic", "normal")
SOURCES = ("textures", "attributes")
# Node and output for each input of the Principled BSDF. Switching the source means linking other nodes: the unused source costs no
# render time, and exporters find the images directly at the Principled BSDF.
LINKS = {
    "textures": {
        "Base Color": ("albedo texture", "Color"),
        "Roughness": ("roughness texture", "Color"),
        "Metallic": ("metallic texture", "Color"),
        "Normal": ("normal map", "Normal"),
    },
    "attributes": {
        "Base Color": ("albedo attribute", "Color"),
        "Roughness": ("roughness attribute", "Fac"),
        "Metallic": ("metallic attribute", "Fac"),
    },
}
FRAMES = {
    "textures": "Textures: images through the UV map (to switch: IRGS++ tab > Look and Relight, or link these to the Principled BSDF)",
    "attributes": "Attributes: values at the vertices (to switch: IRGS++ tab > Look and Relight, or link these to the Principled BSDF)",
}


def build_material(
    material: bpy.types.Material, images: Mapping[str, bpy.types.Image], source: str, heights: Heights | None = None
) -> None:
    """Rebuild the nodes of a material.

    Args:
        material: material to fill.
        images: image datablocks by the names in TEXTURES; empty if the run has only attributes.
        source: "textures" or "attributes".
        heights: of the surface above the mesh; None without.
    """
    nodes, links = node_tree(material)
    principled, output = nodes.new("ShaderNodeBsdfPrincipled"), nodes.new("ShaderNodeOutputMaterial")
    output.location = (350, 0)
    links.new(principled.outputs["BSDF"], output.inputs["Surface"])
    principled.inputs["IOR"].default_value, principled.inputs["Specular IOR Level"].default_value = 1.5, 0.5  # F0 = 0.04
    principled.distribution = "GGX"  # as in the engine's BRDF; Blender's default makes rough metals up to 10 % brighter
    if images:
        _add_textures(nodes, links, images)
    _add_attributes(nodes)
    if heights is not None:
        add_displacement(material, heights)
    use_source(material, source)


def _add_textures(nodes: bpy.types.Nodes, links: bpy.types.NodeLinks, images: Mapping[str, bpy.types.Image]) -> None:
    frame = _frame(nodes, "textures")
    for row, name in enumerate(TEXTURES):
        node = _node(nodes, "ShaderNodeTexImage", f"{name} texture", frame, (-750, 400 - 290 * row))
        node.label, node.image = name, images[name]
    normal = _node(nodes, "ShaderNodeNormalMap", "normal map", frame, (-430, -470))
    links.new(nodes["normal texture"].outputs["Color"], normal.inputs["Color"])


def _add_attributes(nodes: bpy.types.Nodes) -> None:
    frame = _frame(nodes, "attributes")
    for column, name in enumerate(("albedo", "roughness", "metallic")):
        node = _node(nodes, "ShaderNodeAttribute", f"{name} attribute", frame, (-750 + 220 * column, -900))
        node.attribute_type, node.attribute_name, node.label = "GEOMETRY", name, name


def _frame(nodes: bpy.types.Nodes, source: str) -> bpy.types.Node:
    frame = nodes.new("NodeFrame")
    frame.name, frame.label, frame.label_size = source, FRAMES[source], 16
    return frame


def _node(nodes: bpy.types.Nodes, kind: str, name: str, frame: bpy.types.Node, place: tuple[float, float]) -> bpy.types.Node:
    node = nodes.new(kind)
    node.name, node.parent, node.location = name, frame, place
    return node


def principled_of(material: bpy.types.Material) -> bpy.types.Node | None:
    """Return the material's Principled BSDF, or None."""
    nodes = material.node_tree.nodes if material.node_tree else ()
    return next((node for node in nodes if node.bl_idname == "ShaderNodeBsdfPrincipled"), None)


def available_sources(material: bpy.types.Material) -> list[str]:
    """Return the items of SOURCES for which the material has nodes."""
    tree, principled = material.node_tree, principled_of(material)
    if tree is None or principled is None:
        return []
    return [source for source in SOURCES if all(name in tree.nodes for name, _ in LINKS[source].values())]


def source_of(material: bpy.types.Material) -> str | None:
    """Return the source that the material reads, "textures" or "attributes"; None if the user has linked something else."""
    principled = principled_of(material)
    links = principled.inputs["Base Color"].links if principled else ()
    name = links[0].from_node.name if links else ""
    return next((source for source in SOURCES if LINKS[source]["Base Color"][0] == name), None)


def use_source(material: bpy.types.Material, source: str) -> None:
    """Let the material read its textures or the mesh's attributes.

    Args:
        material: material to change.
        source: "textures" or "attributes".

    Raises:
        InputError: if the material has no nodes for this source.
    """
    if source not in available_sources(material):
        raise InputError(material.name, f"has no nodes for {source}", "import the run again")
    tree, principled = material.node_tree, principled_of(material)
    assert tree is not None and principled is not None
    for name in LINKS["textures"]:
        for old in list(principled.inputs[name].links):
            tree.links.remove(old)
    for name, (node, output) in LINKS[source].items():
        tree.links.new(tree.nodes[node].outputs[output], principled.inputs[name])


def _get_source(material: bpy.types.Material) -> int:
    return SOURCES.index(source_of(material) or "textures")


def _set_source(material: bpy.types.Material, value: int) -> None:
    if SOURCES[value] in available_sources(material):  # else nothing changes: the getter returns the source that is linked
        use_source(material, SOURCES[value])


def register() -> None:
    """Add the property `material.irgspp_source`, which stores nothing: it reads and changes the links between nodes."""
    bpy.types.Material.irgspp_source = EnumProperty(**SOURCE, get=_get_source, set=_set_source)


def unregister() -> None:
    """Remove the property `material.irgspp_source`."""
    del bpy.types.Material.irgspp_source
