# SPDX-License-Identifier: GPL-3.0-or-later
"""Controls of a World's light that panels show: its image, rotation and strength, or its one colour."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import bpy

from ...core.errors import InputError
from .light_to_world import world_from_map
from .shader_nodes import uses_nodes

HDRI = "irgspp_hdri"  # custom property of a World that `use_hdri` has made
SUFFIXES = (".hdr", ".exr", ".jpg", ".jpeg", ".png", ".tif", ".tiff", ".webp")  # of images that Blender reads as environment
UP = 2  # index of the rotation about the vertical axis


@dataclass(frozen=True)
class LightControls:
    """Sockets of a World's nodes that an artist sets; None where the World has none or they are linked.

    Attributes:
        image: of the Environment Texture.
        rotation: socket of the Mapping node's rotation.
        colour: socket of the Background's colour.
        strength: socket of the Background's strength.
    """

    image: bpy.types.Image | None = None
    rotation: bpy.types.NodeSocket | None = None
    colour: bpy.types.NodeSocket | None = None
    strength: bpy.types.NodeSocket | None = None


def light_controls(world: bpy.types.World | None) -> LightControls:
    """Return the controls of a World with one Background node; none of them for other Worlds."""
    nodes = world.node_tree.nodes if world is not None and uses_nodes(world) else ()
    backgrounds = [node for node in nodes if node.bl_idname == "ShaderNodeBackground"]
    if len(backgrounds) != 1:
        return LightControls()
    colour, strength = backgrounds[0].inputs["Color"], backgrounds[0].inputs["Strength"]
    texture = colour.links[0].from_node if colour.is_linked else None
    image = texture.image if texture is not None and texture.bl_idname == "ShaderNodeTexEnvironment" else None
    return LightControls(
        image,
        _rotation(texture) if image is not None else None,
        None if colour.is_linked else colour,
        None if strength.is_linked else strength,
    )


def _rotation(texture: bpy.types.Node) -> bpy.types.NodeSocket | None:
    """Return the rotation of the Mapping node before a texture; None without one."""
    vector = texture.inputs["Vector"]
    node = vector.links[0].from_node if vector.is_linked else None
    if node is None or node.bl_idname != "ShaderNodeMapping" or node.inputs["Rotation"].is_linked:
        return None
    return node.inputs["Rotation"]


def use_hdri(scene: bpy.types.Scene, path: Path) -> bpy.types.World:
    """Light a scene by an image of the surroundings, in a World of its own; an earlier one keeps its rotation and strength.

    Args:
        scene: the scene.
        path: lat-long image.

    Raises:
        InputError: if the file is missing or no image.
    """
    if not path.is_file():
        raise InputError(path, "no such file", "choose an image of the surroundings (.hdr or .exr)")
    if path.suffix.lower() not in SUFFIXES:
        raise InputError(path, "is not an image of the surroundings", f"choose one that ends with {', '.join(SUFFIXES)}")
    world = world_from_map(path, path.stem, colour_space=None)
    new = light_controls(world)
    assert new.image is not None
    if not all(new.image.size):
        bpy.data.images.remove(new.image)
        bpy.data.worlds.remove(world)
        raise InputError(path, "can't be read as an image", "choose another file")
    world[HDRI] = True
    _take_over(scene.world, world)
    scene.world = world
    return world


def _take_over(old: bpy.types.World | None, new: bpy.types.World) -> None:
    """Take rotation and strength over from an earlier World of `use_hdri`, and remove that one unless it is used elsewhere."""
    if old is None or HDRI not in old:
        return
    before, after = light_controls(old), light_controls(new)
    for name in ("rotation", "strength"):
        if getattr(before, name) is not None:
            getattr(after, name).default_value = getattr(before, name).default_value
    if old.users == 1 and not old.use_fake_user:
        bpy.data.worlds.remove(old)
