# SPDX-License-Identifier: GPL-3.0-or-later
"""Shader nodes of procedural materials: noise of the world position drives the inputs of a Principled BSDF."""

from __future__ import annotations

import bpy
from irgspp.irgspp_addon.world.shader_nodes import node_tree

Stops = list[tuple[float, tuple[float, float, float]]]  # position along a colour ramp, and linear colour


class ShaderNodes:
    """New material with a Principled BSDF, and the nodes in front of it.

    Attributes:
        material: the material.
        inputs: inputs of the Principled BSDF.
    """

    def __init__(self, name: str) -> None:
        self.material = bpy.data.materials.new(name)
        self._nodes, self._links = node_tree(self.material)
        principled = self._nodes.new("ShaderNodeBsdfPrincipled")
        output = self._nodes.new("ShaderNodeOutputMaterial")
        self._links.new(principled.outputs["BSDF"], output.inputs["Surface"])
        self._position = self._nodes.new("ShaderNodeNewGeometry").outputs["Position"]
        self.inputs = principled.inputs

    def noise(self, scale: float, offset: float, detail: float = 1.0) -> bpy.types.NodeSocket:
        """Return smooth noise of the world position, about 0.3..0.7.

        Args:
            scale: waves per unit of length.
            offset: shift of the position along each axis; another one gives independent noise.
            detail: number of finer octaves.
        """
        shift = self._nodes.new("ShaderNodeVectorMath")
        shift.inputs[1].default_value = (offset, offset, offset)
        noise = self._nodes.new("ShaderNodeTexNoise")
        noise.inputs["Scale"].default_value, noise.inputs["Detail"].default_value = scale, detail
        self._links.new(self._position, shift.inputs[0])
        self._links.new(shift.outputs["Vector"], noise.inputs["Vector"])
        return noise.outputs[0]

    def mapped(self, value: bpy.types.NodeSocket, low: float, high: float) -> bpy.types.NodeSocket:
        """Return noise 0.35..0.65 mapped to low..high."""
        spread = self._nodes.new("ShaderNodeMapRange")
        for index, number in enumerate((0.35, 0.65, low, high), 1):
            spread.inputs[index].default_value = number
        self._links.new(value, spread.inputs[0])
        return spread.outputs[0]

    def coloured(self, value: bpy.types.NodeSocket, stops: Stops) -> bpy.types.NodeSocket:
        """Return the colours of a ramp at the values of a socket."""
        ramp = self._nodes.new("ShaderNodeValToRGB")
        elements = ramp.color_ramp.elements
        while len(elements) < len(stops):
            elements.new(0.5)
        for element, (position, colour) in zip(elements, stops, strict=True):
            element.position, element.color = position, (*colour, 1.0)
        self._links.new(value, ramp.inputs["Fac"])
        return ramp.outputs["Color"]

    def connect(self, value: bpy.types.NodeSocket, name: str) -> None:
        """Connect a socket to an input of the Principled BSDF."""
        self._links.new(value, self.inputs[name])


def dielectric(
    name: str, colour: tuple[float, float], stops: Stops, roughness: tuple[float, float], detail: float = 1.0
) -> bpy.types.Material:
    """Return a dielectric whose colour and roughness vary on scales of their own.

    Args:
        name: name of the material.
        colour: scale and offset of the colour's noise.
        stops: colours along its noise.
        roughness: least and greatest roughness.
        detail: finer octaves of the colour's noise.
    """
    nodes = ShaderNodes(name)
    scale, offset = colour
    nodes.connect(nodes.coloured(nodes.noise(scale, offset, detail), stops), "Base Color")
    nodes.connect(nodes.mapped(nodes.noise(1.3, offset + 8.0), *roughness), "Roughness")
    return nodes.material


def metal(name: str, colour: tuple[float, float, float], roughness: tuple[float, float], offset: float) -> bpy.types.Material:
    """Return a metal of one colour whose roughness varies slowly.

    Args:
        name: name of the material.
        colour: linear reflectance at normal incidence.
        roughness: least and greatest roughness.
        offset: shift of the roughness's noise.
    """
    nodes = ShaderNodes(name)
    nodes.inputs["Base Color"].default_value = (*colour, 1.0)
    nodes.inputs["Metallic"].default_value = 1.0
    nodes.connect(nodes.mapped(nodes.noise(0.8, offset), *roughness), "Roughness")
    return nodes.material
