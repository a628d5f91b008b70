# SPDX-License-Identifier: GPL-3.0-or-later
"""Principled materials that read a run's textures or the mesh's own attributes."""

from __future__ import annotations

from pathlib import Path

import bpy

from .world import load_image, node_tree

TEXTURES = ("albedo", "roughness", "metallic", "normal")


def textured_material(folder: Path, name: str, pack: bool) -> bpy.types.Material:
    """Albedo (sRGB), roughness and metallic (data) and tangent-space normal from the PNGs in `folder`, through the active UV map."""
    material, nodes, links, principled = _principled(name)
    images = {}
    for row, texture in enumerate(TEXTURES):
        image = images[texture] = nodes.new("ShaderNodeTexImage")
        image.label, image.location = texture, (-700, 300 - 280 * row)
        image.image = load_image(folder / f"{texture}.png", "sRGB" if texture == "albedo" else "Non-Color", pack)
    normal = nodes.new("ShaderNodeNormalMap")
    normal.location = (-350, -500)
    links.new(images["albedo"].outputs["Color"], principled.inputs["Base Color"])
    links.new(images["roughness"].outputs["Color"], principled.inputs["Roughness"])
    links.new(images["metallic"].outputs["Color"], principled.inputs["Metallic"])
    links.new(images["normal"].outputs["Color"], normal.inputs["Color"])
    links.new(normal.outputs["Normal"], principled.inputs["Normal"])
    return material


def attribute_material(name: str) -> bpy.types.Material:
    """Albedo, roughness and metallic from the mesh's point attributes of these names."""
    material, nodes, links, principled = _principled(name)
    for row, (attribute, output, socket) in enumerate(
        [("albedo", "Color", "Base Color"), ("roughness", "Fac", "Roughness"), ("metallic", "Fac", "Metallic")]
    ):
        node = nodes.new("ShaderNodeAttribute")
        node.attribute_type, node.attribute_name = "GEOMETRY", attribute
        node.location = (-400, 300 - 200 * row)
        links.new(node.outputs[output], principled.inputs[socket])
    return material


def _principled(name: str):
    material = bpy.data.materials.new(name)
    nodes, links = node_tree(material)
    principled = nodes.new("ShaderNodeBsdfPrincipled")
    output = nodes.new("ShaderNodeOutputMaterial")
    output.location = (350, 0)
    links.new(principled.outputs["BSDF"], output.inputs["Surface"])
    principled.inputs["IOR"].default_value, principled.inputs["Specular IOR Level"].default_value = 1.5, 0.5  # F0 = 0.04
    principled.distribution = "GGX"  # as our BRDF; the default makes rough metals up to a tenth brighter
    return material, nodes, links, principled
