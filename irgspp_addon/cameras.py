# SPDX-License-Identifier: GPL-3.0-or-later
"""Cameras of a run as Blender cameras, with their photographs behind."""

from __future__ import annotations

from pathlib import Path

import bpy
from mathutils import Matrix

from ..core.datasets.camera import Camera


def new_camera(name: str, camera: Camera) -> bpy.types.Object:
    """A Blender camera with the same projection; sizes are kept as custom properties for `look_through`."""
    lens = bpy.data.cameras.new(name)
    set_lens(lens, camera)
    placed = bpy.data.objects.new(name, lens)
    placed.matrix_world = Matrix(camera.to_world.tolist())
    lens["width"], lens["height"], lens["pixel_aspect"] = camera.width, camera.height, camera.fx / camera.fy
    return placed


def set_lens(lens: bpy.types.Camera, camera: Camera) -> None:
    """Focal length and principal point; unequal focal lengths need the scene's pixel aspect as well (`look_through`)."""
    lens.type, lens.sensor_fit = "PERSP", "HORIZONTAL"
    lens.lens = camera.fx / camera.width * lens.sensor_width
    # Blender measures both shifts in picture widths, after the pixel aspect.
    lens.shift_x = (camera.width / 2 - camera.cx) / camera.width
    lens.shift_y = (camera.cy - camera.height / 2) / camera.width * camera.fx / camera.fy


def look_through(scene: bpy.types.Scene, placed: bpy.types.Object) -> None:
    """Make a camera of `new_camera` the active one and give the scene its picture size."""
    scene.camera = placed
    render, lens = scene.render, placed.data
    render.resolution_x, render.resolution_y, render.resolution_percentage = lens["width"], lens["height"], 100
    render.pixel_aspect_x = max(1.0, 1 / lens["pixel_aspect"])
    render.pixel_aspect_y = max(1.0, lens["pixel_aspect"])


def set_background(lens: bpy.types.Camera, picture: Path) -> None:
    """Show a photograph behind the view through the camera; it stays a link to the file."""
    background = lens.background_images.new()
    background.image = bpy.data.images.load(str(picture.resolve()), check_existing=True)
    background.alpha, background.display_depth, background.frame_method = 0.5, "BACK", "STRETCH"
    lens.show_background_images = True
