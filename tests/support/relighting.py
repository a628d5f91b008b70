# SPDX-License-Identifier: GPL-3.0-or-later
"""Helpers of relighting tests in Blender's process: an asymmetric light, a camera to render by, and the preview's image."""

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
    """Return an environment map (64, 128, 3) with a bright spot to one side, which reveals every wrong rotation."""
    directions = map_directions(64, 128)
    return (axis_light(64) + 8 * np.clip(directions @ np.array([0.6, -0.64, 0.48]), 0, 1)[..., None] ** 40).astype(np.float32)


def see_through(scene: bpy.types.Scene, camera: Camera, name: str) -> None:
    """Let a scene render by one of the engine's cameras, to 32-bit EXR images."""
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
    """Return the preview's image, (H, W, 4), top row first."""
    image = bpy.data.images[preview.IMAGE]
    width, height = image.size
    pixels = np.empty(width * height * 4, np.float32)
    image.pixels.foreach_get(pixels)
    return pixels.reshape(height, width, 4)[::-1]


def difference(a: np.ndarray, b: np.ndarray) -> float:
    """Return the mean absolute difference of two arrays, relative to the mean of the second."""
    return float(np.abs(a - b).mean() / b.mean())
