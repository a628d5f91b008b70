# SPDX-License-Identifier: GPL-3.0-or-later
"""Points of a dataset: vertices with colours, shown as little balls by geometry nodes."""

from __future__ import annotations

from itertools import pairwise

import bpy
import numpy as np

from ..world.light_to_world import node_tree
from .ownership import Owner, put

COLOUR = "colour"  # the attribute's name
MODIFIER = "show points"


def build_points(
    owner: Owner,
    name: str,
    position: np.ndarray,
    colour: np.ndarray,
    radius: float,
    root: bpy.types.Object,
    collection: bpy.types.Collection,
) -> bpy.types.Object:
    """A mesh of bare vertices (P, 3) with a point attribute of colours (P, 3) sRGB 0..1; `radius` is the object's size.

    The points are there to look at: they don't render.
    """
    mesh = bpy.data.meshes.new(name)
    mesh.vertices.add(len(position))
    mesh.vertices.foreach_set("co", np.ascontiguousarray(position, np.float32).reshape(-1))
    attribute = mesh.color_attributes.new(COLOUR, "BYTE_COLOR", "POINT")
    attribute.data.foreach_set("color_srgb", np.c_[colour, np.ones(len(colour))].astype(np.float32).reshape(-1))
    mesh.color_attributes.active_color = attribute
    mesh.update()
    mesh = owner.exchanged(bpy.data.meshes, "points data", mesh)
    material = owner.kept(bpy.data.materials, "points material", name)
    _show_colour(material)
    mesh.materials.append(material)
    cloud = owner.object("points", name, mesh, root)
    cloud.hide_render = True
    _show_as_balls(owner, cloud, material, 0.004 * radius)
    put(cloud, collection)
    return cloud


def _show_colour(material: bpy.types.Material) -> None:
    """The colours glow as they are: they were photographed, light and all."""
    nodes, links = node_tree(material)
    attribute, glow, output = (nodes.new(f"ShaderNode{kind}") for kind in ("Attribute", "Emission", "OutputMaterial"))
    attribute.attribute_type, attribute.attribute_name = "GEOMETRY", COLOUR
    attribute.location, output.location = (-250, 0), (250, 0)
    links.new(attribute.outputs["Color"], glow.inputs["Color"])
    links.new(glow.outputs["Emission"], output.inputs["Surface"])


def _show_as_balls(owner: Owner, cloud: bpy.types.Object, material: bpy.types.Material, radius: float) -> None:
    """Bare vertices are next to invisible; a modifier turns them into points of a radius."""
    group = owner.find(bpy.data.node_groups, "points nodes")
    if group is None:
        group = owner.kept(bpy.data.node_groups, "points nodes", cloud.name, "GeometryNodeTree")
        group.interface.new_socket("Geometry", in_out="INPUT", socket_type="NodeSocketGeometry")
        group.interface.new_socket("Geometry", in_out="OUTPUT", socket_type="NodeSocketGeometry")
    group.nodes.clear()
    kinds = ("NodeGroupInput", "GeometryNodeMeshToPoints", "GeometryNodeSetMaterial", "NodeGroupOutput")
    chain = [group.nodes.new(kind) for kind in kinds]
    for column, (node, following) in enumerate(pairwise(chain)):
        following.location = (200 * (column + 1), 0)
        group.links.new(node.outputs[0], following.inputs[0])
    chain[1].inputs["Radius"].default_value = radius
    chain[2].inputs["Material"].default_value = material
    if MODIFIER not in cloud.modifiers:
        cloud.modifiers.new(MODIFIER, "NODES")
    cloud.modifiers[MODIFIER].node_group = group
