# SPDX-License-Identifier: GPL-3.0-or-later
"""Scene of the embedded dataset: Blender's monkey in a mottled glaze on a copper ring; or both of one material, as a .blend file.

python scripts/scenes/demo_scene.py mixed|low-gloss|glossy FILE.blend
"""

from __future__ import annotations

import sys
from math import radians
from pathlib import Path

import bpy
from irgspp.irgspp_addon.world.light_to_world import node_tree

KINDS = {
    "mixed": ("glaze", "copper"),
    "low-gloss": ("glaze", "glaze"),
    "glossy": ("copper", "copper"),
}  # materials of the monkey and of the ring


def build_demo_scene(kind: str = "mixed") -> list[bpy.types.Object]:
    """Fill an empty file with the demonstration's objects, inside radius 1.3 around the origin, and return them.

    Args:
        kind: one of KINDS.
    """
    bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)
    bpy.ops.mesh.primitive_monkey_add(size=1.75, location=(0.0, 0.05, 0.08), rotation=(radians(-18), 0.0, 0.0))
    monkey = bpy.context.object
    subdivision = monkey.modifiers.new("subdivision", "SUBSURF")
    subdivision.levels = subdivision.render_levels = 2
    bpy.ops.mesh.primitive_torus_add(location=(0.0, -0.02, -0.6), major_radius=0.55, minor_radius=0.18, major_segments=64)
    ring = bpy.context.object
    for thing in (monkey, ring):
        bpy.ops.object.select_all(action="DESELECT")
        thing.select_set(True)
        bpy.context.view_layer.objects.active = thing
        bpy.ops.object.shade_smooth()
    materials = {"glaze": _glaze(), "copper": _copper()}
    for thing, name in zip((monkey, ring), KINDS[kind], strict=True):
        thing.data.materials.append(materials[name])
    return [monkey, ring]


def _glaze() -> bpy.types.Material:
    """Return a dielectric with soft patches of four colours, and roughness that varies on another scale."""
    material = bpy.data.materials.new("glaze")
    nodes, links = node_tree(material)
    principled, position = _principled(nodes, links)
    colour = _noise(nodes, links, position, scale=1.15, offset=3.0)
    ramp = nodes.new("ShaderNodeValToRGB")
    patches = [(0.40, (0.03, 0.22, 0.26)), (0.48, (0.62, 0.55, 0.42)), (0.55, (0.62, 0.20, 0.06)), (0.64, (0.10, 0.16, 0.42))]
    _fill(ramp.color_ramp, patches)
    links.new(colour, ramp.inputs["Fac"])
    links.new(ramp.outputs["Color"], principled.inputs["Base Color"])
    links.new(_mapped(nodes, links, _noise(nodes, links, position, scale=1.3, offset=11.0), 0.3, 0.65), principled.inputs["Roughness"])
    return material


def _copper() -> bpy.types.Material:
    """Return a metal whose roughness varies slowly along the ring."""
    material = bpy.data.materials.new("copper")
    nodes, links = node_tree(material)
    principled, position = _principled(nodes, links)
    principled.inputs["Base Color"].default_value = (0.90, 0.48, 0.28, 1.0)
    principled.inputs["Metallic"].default_value = 1.0
    links.new(_mapped(nodes, links, _noise(nodes, links, position, scale=0.8, offset=7.0), 0.18, 0.38), principled.inputs["Roughness"])
    return material


def _principled(nodes, links):
    """Return a Principled BSDF connected to the output, and the world position."""
    principled = nodes.new("ShaderNodeBsdfPrincipled")
    output = nodes.new("ShaderNodeOutputMaterial")
    links.new(principled.outputs["BSDF"], output.inputs["Surface"])
    return principled, nodes.new("ShaderNodeNewGeometry").outputs["Position"]


def _noise(nodes, links, position, scale: float, offset: float):
    """Return smooth noise of the world position, about 0.3..0.7."""
    shift = nodes.new("ShaderNodeVectorMath")
    shift.inputs[1].default_value = (offset, offset, offset)
    noise = nodes.new("ShaderNodeTexNoise")
    noise.inputs["Scale"].default_value, noise.inputs["Detail"].default_value = scale, 1.0
    links.new(position, shift.inputs[0])
    links.new(shift.outputs["Vector"], noise.inputs["Vector"])
    return noise.outputs[0]


def _mapped(nodes, links, value, low: float, high: float):
    """Return noise 0.35..0.65 mapped to low..high."""
    spread = nodes.new("ShaderNodeMapRange")
    for index, number in enumerate((0.35, 0.65, low, high), 1):
        spread.inputs[index].default_value = number
    links.new(value, spread.inputs[0])
    return spread.outputs[0]


def _fill(ramp: bpy.types.ColorRamp, stops: list[tuple[float, tuple[float, float, float]]]) -> None:
    """Set the stops of a colour ramp."""
    while len(ramp.elements) < len(stops):
        ramp.elements.new(0.5)
    for element, (position, colour) in zip(ramp.elements, stops, strict=True):
        element.position, element.color = position, (*colour, 1.0)


if __name__ == "__main__":
    if len(sys.argv) != 3 or sys.argv[1] not in KINDS:
        sys.exit(f"usage: demo_scene.py {'|'.join(KINDS)} FILE.blend")
    build_demo_scene(sys.argv[1])
    bpy.ops.wm.save_as_mainfile(filepath=str(Path(sys.argv[2]).resolve()))
