# SPDX-License-Identifier: GPL-3.0-or-later
"""Light maps as Blender Worlds."""

from __future__ import annotations

from pathlib import Path

import bpy


def world_from_map(path: Path, name: str = "irgspp light", pack: bool = False) -> bpy.types.World:
    """A World lit by a lat-long EXR in our convention, which is Blender's own: no rotation, strength 1."""
    world = bpy.data.worlds.new(name)
    nodes, links = node_tree(world)
    coordinates = nodes.new("ShaderNodeTexCoord")
    mapping = nodes.new("ShaderNodeMapping")  # left at zero: the place where artists turn a light
    texture = nodes.new("ShaderNodeTexEnvironment")
    background = nodes.new("ShaderNodeBackground")
    output = nodes.new("ShaderNodeOutputWorld")
    for column, node in enumerate((coordinates, mapping, texture, background, output)):
        node.location = (-800 + 200 * column, 0)
    texture.image = load_image(path, "Linear Rec.709", pack)
    texture.projection = "EQUIRECTANGULAR"
    links.new(coordinates.outputs["Generated"], mapping.inputs["Vector"])
    links.new(mapping.outputs["Vector"], texture.inputs["Vector"])
    links.new(texture.outputs["Color"], background.inputs["Color"])
    links.new(background.outputs["Background"], output.inputs["Surface"])
    return world


def node_tree(owner: bpy.types.World | bpy.types.Material) -> tuple[bpy.types.Nodes, bpy.types.NodeLinks]:
    """The empty shader nodes of a new World or material; from Blender 5.0 they are always there and `use_nodes` is deprecated."""
    if bpy.app.version < (5, 0, 0):
        owner.use_nodes = True
    tree = owner.node_tree
    assert tree is not None
    tree.nodes.clear()
    return tree.nodes, tree.links


def load_image(path: Path, colour_space: str, pack: bool) -> bpy.types.Image:
    """A new image datablock of a file (one that is there already may hold an older image), packed into the .blend or linked."""
    image = bpy.data.images.load(str(path.resolve()))
    image.colorspace_settings.name = colour_space
    if pack:
        image.pack()
    return image


def bake_world(scene: bpy.types.Scene, target: Path, height: int = 128) -> None:
    """Render the scene's World alone, whatever its nodes, as a lat-long 32-bit EXR in our convention, exactly at the texel centres.

    Uses a scene of its own, removed afterwards; selection, active scene and render result stay. Raises RuntimeError while a render runs,
    which can't hold another.
    """
    if bpy.app.is_job_running("RENDER"):
        raise RuntimeError("the World can't be rendered while another render runs")
    empty = bpy.data.scenes.new("irgspp world bake")
    data = bpy.data.cameras.new("irgspp world bake")
    camera = bpy.data.objects.new("irgspp world bake", data)
    try:
        empty.collection.objects.link(camera)
        empty.world, empty.camera = scene.world, camera
        empty.frame_set(scene.frame_current)
        data.type, data.panorama_type = "PANO", "EQUIRECTANGULAR"
        camera.rotation_euler = (1.5707963267948966, 0.0, -1.5707963267948966)  # +X in the middle of the image
        _set_render(empty, target, height)
        bpy.ops.render.render(write_still=True, scene=empty.name)
    finally:
        bpy.data.scenes.remove(empty)
        bpy.data.cameras.remove(data)


def _set_render(scene: bpy.types.Scene, target: Path, height: int) -> None:
    render, cycles = scene.render, scene.cycles
    render.engine = "CYCLES"
    cycles.device, cycles.use_denoising = "CPU", False
    cycles.samples, cycles.use_adaptive_sampling = 1, False  # the first sample is the centre of the pixel, later ones are scattered
    cycles.pixel_filter_type, cycles.filter_width = "BLACKMAN_HARRIS", 0.01
    render.resolution_x, render.resolution_y, render.resolution_percentage = 2 * height, height, 100
    settings = render.image_settings
    settings.file_format, settings.color_depth, settings.color_mode = "OPEN_EXR", "32", "RGB"
    render.filepath = str(target.resolve())
