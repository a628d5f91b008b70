# SPDX-License-Identifier: GPL-3.0-or-later
"""Cameras of a dataset or run as Blender cameras, with their photographs behind."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import bpy
import numpy as np
from mathutils import Matrix

from ...core.scene.camera import Camera
from ...core.scene.camera_files import PlacedCamera
from .ownership import Owner, link, put


def place_cameras(
    owner: Owner, records: Sequence[PlacedCamera], root: bpy.types.Object, parent: bpy.types.Collection, photographs: bool = True
) -> list[bpy.types.Object]:
    """The cameras in a collection of their own below `parent`, each with its photograph where that is there."""
    folder = owner.kept(bpy.data.collections, "cameras", f"{parent.name} cameras")
    link(folder, parent)
    rig = _rig(owner, root, folder)
    distance = float(np.median([np.linalg.norm(record.camera.centre) for record in records])) if records else 1.0
    placed = []
    for record in records:
        name = f"{record.split} {record.name}"
        lens = owner.kept(bpy.data.cameras, f"lens {name}", name)
        thing = owner.object(f"camera {name}", name, lens, rig)
        set_camera(thing, record.camera)
        lens.display_size, lens.clip_start, lens.clip_end = 0.025 * distance, 0.01 * distance, 100 * distance
        _replace_background(lens, record.image if photographs and record.image.is_file() else None)  # it may have moved since
        put(thing, folder)
        placed.append(thing)
    return placed


def _rig(owner: Owner, root: bpy.types.Object, folder: bpy.types.Collection) -> bpy.types.Object:
    """What the cameras hang on: hidden, so that no dotted line leads from each of them to the empty that carries everything."""
    known = owner.find(bpy.data.objects, "camera rig")
    rig = owner.object("camera rig", folder.name, None, root)
    if known is None:
        rig.hide_viewport = rig.hide_select = True
    rig.matrix_parent_inverse = rig.matrix_basis = Matrix()
    put(rig, folder)
    return rig


def set_camera(placed: bpy.types.Object, camera: Camera) -> None:
    """The same projection, relative to the object's parent; sizes are kept as custom properties for `look_through`."""
    lens = placed.data
    set_lens(lens, camera)
    placed.rotation_mode = "QUATERNION"  # three angles lose digits near the vertical
    placed.matrix_parent_inverse = Matrix()
    placed.matrix_basis = Matrix(camera.to_world.tolist())
    lens["width"], lens["height"], lens["pixel_aspect"] = camera.width, camera.height, camera.fx / camera.fy


def set_lens(lens: bpy.types.Camera, camera: Camera) -> None:
    """Focal length and principal point; unequal focal lengths need the scene's pixel aspect as well (`look_through`)."""
    lens.type, lens.sensor_fit, lens.sensor_width = "PERSP", "HORIZONTAL", 36.0
    lens.lens = camera.fx / camera.width * lens.sensor_width
    # Blender measures both shifts in image widths, after the pixel aspect.
    lens.shift_x = (camera.width / 2 - camera.cx) / camera.width
    lens.shift_y = (camera.cy - camera.height / 2) / camera.width * camera.fx / camera.fy


def look_through(scene: bpy.types.Scene, placed: bpy.types.Object) -> None:
    """Make an imported camera the active one and give the scene its image size."""
    scene.camera = placed
    render, lens = scene.render, placed.data
    render.resolution_x, render.resolution_y, render.resolution_percentage = lens["width"], lens["height"], 100
    render.pixel_aspect_x = max(1.0, 1 / lens["pixel_aspect"])
    render.pixel_aspect_y = max(1.0, lens["pixel_aspect"])


def _replace_background(lens: bpy.types.Camera, photograph: Path | None) -> None:
    before = [background.image for background in lens.background_images if background.image]
    for background in lens.background_images:
        background.image = None  # Blender goes on counting it as a user otherwise
    lens.background_images.clear()
    lens.show_background_images = False
    if photograph is not None:
        set_background(lens, photograph)
    for image in before:
        if not image.users:
            bpy.data.images.remove(image)


def set_background(lens: bpy.types.Camera, image: Path) -> None:
    """Show a photograph behind the view through the camera; it stays a link to the file."""
    background = lens.background_images.new()
    background.image = bpy.data.images.load(str(image.resolve()), check_existing=True)
    background.alpha, background.display_depth, background.frame_method = 0.5, "BACK", "STRETCH"
    lens.show_background_images = True
