# SPDX-License-Identifier: GPL-3.0-or-later
"""Displacement of a run's mesh by its height texture: nodes that are there, and linked only where the user wants it."""

from __future__ import annotations

from dataclasses import dataclass

import bpy
from bpy.props import BoolProperty

from ..shared_properties import DISPLACE

IMAGE, NODE = "height texture", "displacement"  # names of the nodes
FRAME = (
    "Height: displaces the mesh (to switch: IRGS++ tab > Look and Relight, or link it to the Material Output); subdivide the mesh before"
)


@dataclass(frozen=True)
class Heights:
    """Heights above a mesh for Blender's Displacement node.

    Attributes:
        image: height texture, Non-Color.
        scale: range of the heights, in the mesh's own units.
        midlevel: value of height 0.
    """

    image: bpy.types.Image
    scale: float
    midlevel: float


def add_displacement(material: bpy.types.Material, heights: Heights) -> None:
    """Add the nodes of the displacement without linking them to the material's output, so that nothing renders differently.

    Args:
        material: with a node tree.
        heights: of the surface above the mesh.
    """
    tree = material.node_tree
    frame = tree.nodes.new("NodeFrame")
    frame.name, frame.label, frame.label_size = "height", FRAME, 16
    image, node = tree.nodes.new("ShaderNodeTexImage"), tree.nodes.new("ShaderNodeDisplacement")
    image.name, image.label, image.image = IMAGE, "height", heights.image
    node.name, node.space = NODE, "OBJECT"  # the scale follows that of the object
    for one, place in ((image, (-750, -1150)), (node, (-430, -1150))):
        one.parent, one.location = frame, place
    node.inputs["Scale"].default_value, node.inputs["Midlevel"].default_value = heights.scale, heights.midlevel
    tree.links.new(image.outputs["Color"], node.inputs["Height"])


def has_displacement(material: bpy.types.Material) -> bool:
    """Return True for a material that has the nodes of a displacement."""
    return material.node_tree is not None and NODE in material.node_tree.nodes


def displaces(material: bpy.types.Material) -> bool:
    """Return True where the material displaces the mesh by its heights."""
    return has_displacement(material) and material.node_tree.nodes[NODE].outputs["Displacement"].is_linked


def displace(material: bpy.types.Material, on: bool) -> None:
    """Let a material displace the mesh, or not.

    Args:
        material: one that `has_displacement`.
        on: True to displace.
    """
    tree = material.node_tree
    output, node = tree.get_output_node("ALL"), tree.nodes[NODE]
    for link in list(node.outputs["Displacement"].links):
        tree.links.remove(link)
    if on and output is not None:
        tree.links.new(node.outputs["Displacement"], output.inputs["Displacement"])
    # Bump alone, Blender's default, would add to the normal map what that has already.
    material.displacement_method = "DISPLACEMENT" if on else "BUMP"


def register() -> None:
    """Add the property `material.irgspp_displace`, which stores nothing: it reads and changes the links between nodes."""
    bpy.types.Material.irgspp_displace = BoolProperty(**DISPLACE, get=displaces, set=_set)


def _set(material: bpy.types.Material, on: bool) -> None:
    if has_displacement(material):  # else nothing changes: the getter returns what is linked
        displace(material, on)


def unregister() -> None:
    """Remove the property `material.irgspp_displace`."""
    del bpy.types.Material.irgspp_displace
