# SPDX-License-Identifier: GPL-3.0-or-later
"""A light in which every turn is seen, a camera to look through, and the preview's image, for tests in Blender's process."""

from __future__ import annotations

import blender_side  # noqa: F401
import bpy
import numpy as np
from irgspp.core.scene.camera import Camera
from irgspp.irgspp_addon.importer.cameras import set_lens
from irgspp.irgspp_addon.relight import preview
from mathutils import Matrix
from sphere_run import axis_light, map_directions


def lamp() -> np.ndarray:
    """The smooth light with something bright to one side: what is turned wrongly is seen."""
    directions = map_directions(64, 128)
    return (axis_light(64) + 8 * np.clip(directions @ np.array([0.6, -0.64, 0.48]), 0, 1)[..., None] ** 40).astype(np.float32)


def see_through(scene: bpy.types.Scene, camera: Camera, name: str) -> None:
    """Render a scene by a camera of ours, to images of floats."""
    lens = bpy.data.cameras.new(name)
    set_lens(lens, camera)
    scene.camera = bpy.data.objects.new(name, lens)
    scene.collection.objects.link(scene.camera)
    scene.camera.matrix_world = Matrix(camera.to_world.tolist())
    scene.render.resolution_x, scene.render.resolution_y = camera.width, camera.height
    scene.render.image_settings.file_format, scene.render.image_settings.color_depth = "OPEN_EXR", "32"


def mapping(scene):
    return next(node for node in scene.world.node_tree.nodes if node.bl_idname == "ShaderNodeMapping")


def image_pixels() -> np.ndarray:
    image = bpy.data.images[preview.IMAGE]
    width, height = image.size
    pixels = np.empty(width * height * 4, np.float32)
    image.pixels.foreach_get(pixels)
    return pixels.reshape(height, width, 4)[::-1]


def difference(a: np.ndarray, b: np.ndarray) -> float:
    """Mean difference, relative to the mean."""
    return float(np.abs(a - b).mean() / b.mean())
