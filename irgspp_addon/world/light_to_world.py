# SPDX-License-Identifier: GPL-3.0-or-later
"""Conversion of environment maps to Blender Worlds, and of Worlds to environment maps by rendering."""

from __future__ import annotations

from pathlib import Path

import bpy

from ..image_path import path_in_file
from .shader_nodes import node_tree

LEAST_SAMPLED, MOST_SAMPLED = 512, 4096  # width in texels of the table from which Cycles draws light samples


def world_from_map(
    path: Path, name: str = "irgspp light", pack: bool = False, colour_space: str | None = "Linear Rec.709"
) -> bpy.types.World:
    """Create a World with an environment map, whose convention is Blender's own: no rotation, strength 1.

    Args:
        path: lat-long image.
        name: name of the World.
        pack: True to pack the image into the .blend.
        colour_space: of the image; None: what Blender takes it for.
    """
    world = bpy.data.worlds.new(name)
    nodes, links = node_tree(world)
    coordinates = nodes.new("ShaderNodeTexCoord")
    mapping = nodes.new("ShaderNodeMapping")  # without rotation; artists use this node to rotate the light
    texture = nodes.new("ShaderNodeTexEnvironment")
    background = nodes.new("ShaderNodeBackground")
    output = nodes.new("ShaderNodeOutputWorld")
    for column, node in enumerate((coordinates, mapping, texture, background, output)):
        node.location = (-800 + 200 * column, 0)
    texture.image = load_image(path, colour_space, pack)
    texture.projection = "EQUIRECTANGULAR"
    _sample_at_resolution(world, texture.image.size[0])
    links.new(coordinates.outputs["Generated"], mapping.inputs["Vector"])
    links.new(mapping.outputs["Vector"], texture.inputs["Vector"])
    links.new(texture.outputs["Color"], background.inputs["Color"])
    links.new(background.outputs["Background"], output.inputs["Surface"])
    return world


def _sample_at_resolution(world: bpy.types.World, width: int) -> None:
    """Let Cycles draw its light samples from a table as wide as the map: its own choice, 4096, takes 2 seconds before every render."""
    if hasattr(world, "cycles"):
        world.cycles.sampling_method = "MANUAL"
        world.cycles.sample_map_resolution = min(max(width, LEAST_SAMPLED), MOST_SAMPLED)


def load_image(path: Path, colour_space: str | None, pack: bool) -> bpy.types.Image:
    """Load a file as a new image datablock, since an existing one may hold an older version of the file.

    Args:
        path: image file.
        colour_space: name of its colour space in Blender; None: what Blender takes it for.
        pack: True to pack the image into the .blend, False to link the file.
    """
    image = bpy.data.images.load(path_in_file(path))
    if colour_space is not None:
        image.colorspace_settings.name = colour_space
    if pack:
        image.pack()
    return image


def bake_world(scene: bpy.types.Scene, target: Path, height: int = 128) -> None:
    """Render the scene's World, whatever its nodes, as a lat-long 32-bit EXR, sampled exactly at the texel centres.

    It uses a temporary scene; selection, active scene and render result stay.

    Args:
        scene: scene of the World.
        target: EXR file to write.
        height: height of the image in pixels; its width is twice that.

    Raises:
        RuntimeError: if another render is running, since Blender can't run two at once.
    """
    if bpy.app.is_job_running("RENDER"):
        raise RuntimeError("the World can't be rendered while another render runs")
    empty = bpy.data.scenes.new("irgspp world bake")
    data = bpy.data.cameras.new("irgspp world bake")
    camera = bpy.data.objects.new("irgspp world bake", data)
    world = scene.world.copy() if scene.world is not None else None
    try:
        if world is not None and hasattr(world, "cycles"):
            world.cycles.sampling_method = "NONE"  # nothing is lit, and the table of light samples takes 2 seconds
        empty.collection.objects.link(camera)
        empty.world, empty.camera = world, camera
        empty.frame_set(scene.frame_current)
        data.type, data.panorama_type = "PANO", "EQUIRECTANGULAR"
        camera.rotation_euler = (1.5707963267948966, 0.0, -1.5707963267948966)  # +X in the middle of the image
        _set_render(empty, target, height)
        bpy.ops.render.render(write_still=True, scene=empty.name)
    finally:
        bpy.data.scenes.remove(empty)
        bpy.data.cameras.remove(data)
        if world is not None:
            bpy.data.worlds.remove(world)


def _set_render(scene: bpy.types.Scene, target: Path, height: int) -> None:
    render, cycles = scene.render, scene.cycles
    render.engine = "CYCLES"
    cycles.device, cycles.use_denoising = "CPU", False
    cycles.samples, cycles.use_adaptive_sampling = 1, False  # the first sample is at the pixel's centre, later ones are not
    cycles.pixel_filter_type, cycles.filter_width = "BLACKMAN_HARRIS", 0.01
    render.resolution_x, render.resolution_y, render.resolution_percentage = 2 * height, height, 100
    settings = render.image_settings
    settings.file_format, settings.color_depth, settings.color_mode = "OPEN_EXR", "32", "RGB"
    render.filepath = str(target.resolve())
