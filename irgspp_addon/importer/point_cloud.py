# SPDX-License-Identifier: GPL-3.0-or-later
"""Point cloud of a dataset: a mesh of vertices with colours, shown as small spheres by geometry nodes."""

from __future__ import annotations

from itertools import pairwise

import bpy
import numpy as np

from ..world.shader_nodes import node_tree
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
    size: float = 0.004,
) -> bpy.types.Object:
    """Create a mesh object of vertices with a colour attribute, visible in viewports but not in renders.

    Args:
        owner: owner of the datablocks.
        name: name of new datablocks.
        position: (P, 3) positions.
        colour: (P, 3) sRGB colours, 0..1.
        radius: radius of the scene's object, which sets the size of the shown points.
        root: parent of the object.
        collection: collection of the object.
        size: radius of a shown point over that of the scene's object.
    """
    mesh = bpy.data.meshes.new(name)
    mesh.vertices.add(len(position))
    mesh.vertices.foreach_set("co", np.ascontiguousarray(position, np.float32).reshape(-1))
    attribute = mesh.color_attributes.new(COLOUR, "BYTE_COLOR", "POINT")
    attribute.data.foreach_set("color_srgb", np.c_[colour, np.ones(len(colour))].astype(np.float32).reshape(-1))
    mesh.color_attributes.active_color = attribute
    mesh.update()
    mesh = owner.replace(bpy.data.meshes, "points data", mesh)
    material = owner.reuse(bpy.data.materials, "points material", name)
    _show_colour(material)
    mesh.materials.append(material)
    cloud = owner.object("points", name, mesh, root)
    cloud.hide_render = True
    _show_as_spheres(owner, cloud, material, size * radius)
    put(cloud, collection)
    return cloud


def _show_colour(material: bpy.types.Material) -> None:
    """Show the colours by emission, since they come from photographs and already include the light."""
    nodes, links = node_tree(material)
    attribute, glow, output = (nodes.new(f"ShaderNode{kind}") for kind in ("Attribute", "Emission", "OutputMaterial"))
    attribute.attribute_type, attribute.attribute_name = "GEOMETRY", COLOUR
    attribute.location, output.location = (-250, 0), (250, 0)
    links.new(attribute.outputs["Color"], glow.inputs["Color"])
    links.new(glow.outputs["Emission"], output.inputs["Surface"])


def _show_as_spheres(owner: Owner, cloud: bpy.types.Object, material: bpy.types.Material, radius: float) -> None:
    """Add a modifier that turns the vertices, which are hardly visible by themselves, into points with a radius."""
    group = owner.find(bpy.data.node_groups, "points nodes")
    if group is None:
        group = owner.reuse(bpy.data.node_groups, "points nodes", cloud.name, "GeometryNodeTree")
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
