# SPDX-License-Identifier: GPL-3.0-or-later
"""Images of the inputs of a material's Principled BSDF as Cycles evaluates them, each rendered as emission."""

from __future__ import annotations

from pathlib import Path

import bpy
import numpy as np
from blender_side import read_image

INPUTS = ("Base Color", "Roughness", "Metallic", "Normal")


def glowing_inputs(scene: bpy.types.Scene, material: bpy.types.Material, folder: Path, samples: int = 16) -> dict[str, np.ndarray]:
    """Render each of INPUTS as emission: (H, W, 4) linear premultiplied RGBA, a normal n as (n + 1) / 2; the material is changed."""
    tree = material.node_tree
    principled = next(node for node in tree.nodes if node.bl_idname == "ShaderNodeBsdfPrincipled")
    output = next(node for node in tree.nodes if node.bl_idname == "ShaderNodeOutputMaterial")
    glow = tree.nodes.new("ShaderNodeEmission")
    tree.links.new(glow.outputs["Emission"], output.inputs["Surface"])
    layers = {}
    for name in INPUTS:
        tree.links.new(_half(tree, principled.inputs[name]) if name == "Normal" else _source(principled.inputs[name]), glow.inputs["Color"])
        layers[name] = render(scene, folder / f"{name}.exr", samples)
    return layers


def _source(socket: bpy.types.NodeSocket) -> bpy.types.NodeSocket:
    return socket.links[0].from_socket


def _half(tree: bpy.types.NodeTree, socket: bpy.types.NodeSocket) -> bpy.types.NodeSocket:
    half = tree.nodes.new("ShaderNodeVectorMath")
    half.operation = "MULTIPLY_ADD"
    half.inputs[1].default_value = half.inputs[2].default_value = (0.5, 0.5, 0.5)
    normal = _source(socket) if socket.is_linked else tree.nodes.new("ShaderNodeNewGeometry").outputs["Normal"]
    tree.links.new(normal, half.inputs[0])
    return half.outputs["Vector"]


def render(scene: bpy.types.Scene, path: Path, samples: int) -> np.ndarray:
    """Render a scene by Cycles over a transparent background into an EXR file; return (H, W, 4) linear premultiplied RGBA."""
    scene.render.engine, scene.render.film_transparent = "CYCLES", True
    scene.cycles.samples, scene.cycles.use_denoising, scene.cycles.use_adaptive_sampling = samples, False, False
    settings = scene.render.image_settings
    settings.file_format, settings.color_depth, settings.color_mode = "OPEN_EXR", "32", "RGBA"
    scene.render.filepath = str(path)
    bpy.ops.render.render(write_still=True, scene=scene.name)
    return read_image(path, channels=4)
