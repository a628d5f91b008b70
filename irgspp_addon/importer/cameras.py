# SPDX-License-Identifier: GPL-3.0-or-later
"""Blender cameras for the cameras of a dataset or run, with their photographs as background images."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import bpy
import numpy as np
from mathutils import Matrix

from ...core.scene.camera import Camera
from ...core.scene.camera_files import PlacedCamera
from ..image_path import path_in_file
from .ownership import Owner, link, put

BEHIND = 0.5  # opacity of a photograph behind the scene


def place_cameras(
    owner: Owner, records: Sequence[PlacedCamera], root: bpy.types.Object, parent: bpy.types.Collection, photographs: bool = True
) -> list[bpy.types.Object]:
    """Create a Blender camera for each camera, in a collection of their own.

    Args:
        owner: owner of the datablocks.
        records: cameras with their names, splits and photographs.
        root: empty above all imported objects.
        parent: collection that receives the collection of cameras.
        photographs: True to show the photographs that exist as background images.

    Returns:
        Camera objects in the order of `records`.
    """
    cameras = owner.reuse(bpy.data.collections, "cameras", f"{parent.name} cameras")
    if not cameras.users:  # else it may be anywhere, such as beside the collection of an asset
        link(cameras, parent)
    rig = _rig(owner, root, cameras)
    distance = float(np.median([np.linalg.norm(record.camera.centre) for record in records])) if records else 1.0
    placed = []
    for record in records:
        name = f"{record.split} {record.name}"
        lens = owner.reuse(bpy.data.cameras, f"lens {name}", name)
        camera = owner.object(f"camera {name}", name, lens, rig)
        set_camera(camera, record.camera)
        lens.display_size, lens.clip_start, lens.clip_end = 0.025 * distance, 0.01 * distance, 100 * distance
        if not photographs or record.image.is_file() or not _has_photograph(lens):  # which a moved project's camera may show already
            _replace_background(lens, record.image if photographs and record.image.is_file() else None)
        put(camera, cameras)
        placed.append(camera)
    return placed


def _rig(owner: Owner, root: bpy.types.Object, cameras: bpy.types.Collection) -> bpy.types.Object:
    """Return the empty above the cameras: it is hidden, so that Blender draws no relationship line from each camera to the root."""
    existing = owner.find(bpy.data.objects, "camera rig")
    rig = owner.object("camera rig", cameras.name, None, root)
    if existing is None:
        rig.hide_viewport = rig.hide_select = True
    rig.matrix_parent_inverse = rig.matrix_basis = Matrix()
    put(rig, cameras)
    return rig


def set_camera(placed: bpy.types.Object, camera: Camera) -> None:
    """Set the projection and pose of a Blender camera, and store the image size as custom properties for `look_through`.

    Args:
        placed: camera object; its pose is set relative to its parent.
        camera: projection and pose.
    """
    lens = placed.data
    set_lens(lens, camera)
    placed.rotation_mode = "QUATERNION"  # Euler angles lose precision near the vertical
    placed.matrix_parent_inverse = Matrix()
    placed.matrix_basis = Matrix(camera.to_world.tolist())
    lens["width"], lens["height"], lens["pixel_aspect"] = camera.width, camera.height, camera.fx / camera.fy


def set_lens(lens: bpy.types.Camera, camera: Camera) -> None:
    """Set focal length and principal point; unequal focal lengths also need the scene's pixel aspect, see `look_through`.

    Args:
        lens: Blender camera data.
        camera: camera whose intrinsics are taken.
    """
    lens.type, lens.sensor_fit, lens.sensor_width = "PERSP", "HORIZONTAL", 36.0
    lens.lens = camera.fx / camera.width * lens.sensor_width
    # Blender measures both shifts in image widths, after the pixel aspect.
    lens.shift_x = (camera.width / 2 - camera.cx) / camera.width
    lens.shift_y = (camera.cy - camera.height / 2) / camera.width * camera.fx / camera.fy


def look_through(scene: bpy.types.Scene, placed: bpy.types.Object) -> None:
    """Make an imported camera the scene's active camera and set the scene's resolution and pixel aspect to the camera's.

    Args:
        scene: scene to change.
        placed: camera object with the custom properties of `set_camera`.
    """
    scene.camera = placed
    render, lens = scene.render, placed.data
    render.resolution_x, render.resolution_y, render.resolution_percentage = lens["width"], lens["height"], 100
    render.pixel_aspect_x = max(1.0, 1 / lens["pixel_aspect"])
    render.pixel_aspect_y = max(1.0, lens["pixel_aspect"])


def _has_photograph(lens: bpy.types.Camera) -> bool:
    """Return True where a camera's background image is a file that exists."""
    shown = [background.image.filepath for background in lens.background_images if background.image]
    return any(Path(bpy.path.abspath(path)).is_file() for path in shown)


def _replace_background(lens: bpy.types.Camera, photograph: Path | None) -> None:
    before = [background.image for background in lens.background_images if background.image]
    for background in lens.background_images:
        background.image = None  # else Blender still counts it as a user
    lens.background_images.clear()
    lens.show_background_images = False
    if photograph is not None:
        set_background(lens, photograph)
    for image in before:
        if not image.users:
            bpy.data.images.remove(image)


def set_background(lens: bpy.types.Camera, image: Path) -> None:
    """Show a photograph as the camera's background image, linked to its file and not packed.

    Args:
        lens: Blender camera data.
        image: file of the photograph.
    """
    background = lens.background_images.new()
    background.image = bpy.data.images.load(path_in_file(image), check_existing=True)
    background.alpha, background.display_depth, background.frame_method = BEHIND, "BACK", "STRETCH"
    lens.show_background_images = True
