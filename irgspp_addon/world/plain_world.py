# SPDX-License-Identifier: GPL-3.0-or-later
"""Environment maps of plain Worlds (one image or one colour), which are read without rendering."""

from __future__ import annotations

import bpy
import numpy as np
from mathutils import Euler

from ...core.errors import InputError
from ...core.scene.environment_map import EnvironmentMap, reduced
from .shader_nodes import uses_nodes

LINEAR = ("Linear Rec.709", "Non-Color", "Linear", "Raw", "scene_linear")
MOST_ROWS = 2048  # larger images are reduced to about this height, which is enough for lighting

_cache: dict[tuple, np.ndarray | None] = {}  # texels of the image read last


def plain_light(world: bpy.types.World | None) -> EnvironmentMap | None:
    """Return the environment map of a plain World, or None if the World has to be rendered.

    A World is plain if it is one colour, or has the nodes Environment Texture -> Background -> World Output, optionally with a Mapping
    that only rotates.

    Raises:
        InputError: if there is no World or its image is missing.
    """
    if world is None:
        raise InputError("the scene", "has no World to light the object by", "add one in the World properties")
    if not uses_nodes(world):
        return _colour(world.color)
    output = world.node_tree.get_output_node("CYCLES")
    surface = _source(output.inputs["Surface"]) if output else None
    if output is None or not output.inputs["Surface"].is_linked:
        return _colour((0.0, 0.0, 0.0))
    if output.inputs["Volume"].is_linked or surface is None or surface.bl_idname != "ShaderNodeBackground":
        return None
    return _background(world, surface)


def _background(world: bpy.types.World, node: bpy.types.Node) -> EnvironmentMap | None:
    """Return the environment map of a Background node, or None if it has to be rendered."""
    colour, strength = node.inputs["Color"], node.inputs["Strength"]
    if strength.is_linked:
        return None
    if not colour.is_linked:
        return _colour(strength.default_value * np.array(colour.default_value[:3]))
    texture = _source(colour)
    if texture is None or texture.bl_idname != "ShaderNodeTexEnvironment":
        return None
    rotation = _rotation(texture.inputs["Vector"])
    if rotation is None or texture.projection != "EQUIRECTANGULAR" or texture.interpolation != "Linear":
        return None
    texels = _image(world, texture.image)
    return None if texels is None else EnvironmentMap(texels, rotation, max(0.0, strength.default_value))


def _source(socket: bpy.types.NodeSocket) -> bpy.types.Node | None:
    """Return the node linked to an input socket; None if there is none or it is muted."""
    if len(socket.links) != 1 or socket.links[0].is_muted or socket.links[0].from_node.mute:
        return None
    return socket.links[0].from_node


def _rotation(vector: bpy.types.NodeSocket) -> np.ndarray | None:
    """Return the rotation (3, 3) of directions before the image lookup; None if the nodes do more than rotate."""
    if not vector.is_linked:
        return np.eye(3)
    node = _source(vector)
    if node is None:
        return None
    if node.bl_idname == "ShaderNodeTexCoord":
        return np.eye(3) if vector.links[0].from_socket.identifier == "Generated" else None
    if node.bl_idname != "ShaderNodeMapping" or node.vector_type not in ("POINT", "TEXTURE"):
        return None
    inputs = {name: node.inputs[name] for name in ("Location", "Rotation", "Scale")}
    if any(socket.is_linked for socket in inputs.values()) or not node.inputs["Vector"].is_linked:
        return None
    if any(inputs["Location"].default_value) or any(value != 1 for value in inputs["Scale"].default_value):
        return None
    rotation = np.array(Euler(inputs["Rotation"].default_value, "XYZ").to_matrix())
    before = _rotation(node.inputs["Vector"])
    return None if before is None else (rotation if node.vector_type == "POINT" else rotation.T) @ before


def _image(world: bpy.types.World, image: bpy.types.Image | None) -> np.ndarray | None:
    """Return an image's linear texels (H, W, 3), top row first; None if its kind or colour space requires rendering by Cycles."""
    if image is None:
        raise InputError(f"World {world.name}", "its Environment Texture has no image", "open one, or remove the node")
    if image.source not in ("FILE", "GENERATED"):
        return None
    width, height = image.size  # reading the size makes Blender load the file
    if not image.has_data or not width or not height:
        raise InputError(f"World {world.name}", f"the image {image.name} can't be read ({image.filepath or 'no file'})", "find the file")
    name = image.colorspace_settings.name
    if name not in LINEAR and (image.is_float or name != "sRGB"):
        return None
    key = (image.name_full, image.as_pointer(), image.filepath, width, height, name)
    if key not in _cache or image.is_dirty:
        _cache.clear()
        _cache[key] = _texels(image, name == "sRGB")
    return _cache[key]


def _texels(image: bpy.types.Image, encoded: bool) -> np.ndarray | None:
    """Return an image's linear texels (H, W, 3), top row first; None for images with transparency or two channels."""
    width, height = image.size
    pixels = np.empty(width * height * image.channels, np.float32)
    image.pixels.foreach_get(pixels)
    pixels = pixels.reshape(height, width, image.channels)[::-1]
    if image.channels == 2 or (image.channels == 4 and pixels[..., 3].min() < 1):
        return None
    colour = np.repeat(pixels, 3, -1) if image.channels == 1 else pixels[..., :3]
    if encoded:
        colour = np.where(colour <= 0.04045, colour / 12.92, ((np.maximum(colour, 0.04045) + 0.055) / 1.055) ** 2.4)
    return _valid(reduced(colour, -(-height // MOST_ROWS)))


def forget_images() -> None:
    """Clear the cache of texels: images may have changed unnoticed, such as when another file was opened."""
    _cache.clear()


def _colour(colour) -> EnvironmentMap:
    return EnvironmentMap(_valid(np.array(colour, np.float32)[None, None, :3]))


def _valid(texels: np.ndarray) -> np.ndarray:
    """Replace values that are not finite or negative by 0."""
    return np.clip(np.nan_to_num(texels, nan=0.0, posinf=0.0, neginf=0.0), 0, None).astype(np.float32)
