# SPDX-License-Identifier: GPL-3.0-or-later
"""The relit object as the image "IRGS++ Relight", kept up to date while a person works."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import bpy
import numpy as np

from ...core.errors import InputError
from ...core.scene.camera import Camera
from ..importer.run_frame import Frame, scene_camera, view_camera
from ..windows import areas, enlarged, redraw
from .live_image import Follower, follow, follower_of, stop

IMAGE = "IRGS++ Relight"
CHANNEL = "image"


def start_preview(scene: bpy.types.Scene, run: Path, how: dict[str, Any], resolution: int, area: bpy.types.Area | None = None) -> Follower:
    """Follow the scene: from its camera, or as the 3D View `area` shows it. how: overrides of `settings_of`.

    Raises InputError where there is no camera to begin with.
    """
    if area is None and scene.camera is None:
        raise InputError(f"scene {scene.name}", "has no camera", "add one, or look from the 3D View")
    spot = _View(area) if area is not None else None

    def size(scene: bpy.types.Scene) -> tuple[int, int]:
        render = scene.render
        wide, high = spot.size() if spot else (render.resolution_x * render.pixel_aspect_x, render.resolution_y * render.pixel_aspect_y)
        scale = resolution / max(wide, high)
        return max(1, round(wide * scale)), max(1, round(high * scale))

    def eye(scene: bpy.types.Scene, frame: Frame, width: int, height: int) -> Camera:
        if spot is not None:
            return view_camera(spot.view(), width, height, frame, spot.size())
        # Sizes are those of the image as it is shown, so pixels are square.
        return scene_camera(scene, bpy.context.evaluated_depsgraph_get(), width, height, frame, square=True)

    follower = Follower(CHANNEL, scene, run, eye, size, lambda scene: {**settings_of(scene), **how}, _show)
    follow(follower)
    return follower


def stop_preview() -> None:
    """End the preview; the image stays."""
    stop(CHANNEL)


def preview_running() -> bool:
    """True while the image follows the scene."""
    follower = follower_of(CHANNEL)
    return follower is not None and not follower.ended


def preview_message() -> str:
    """What the preview is at, or why it ended, in words; "" where there was none."""
    follower = follower_of(CHANNEL)
    return follower.message if follower is not None else ""


def settings_of(scene: bpy.types.Scene) -> dict[str, Any]:
    """What the scene says of relighting."""
    said = scene.irgspp
    return {
        "samples": said.relight_samples,
        "denoise": said.relight_denoise,
        "backend": said.relight_backend,
        "use_world": said.use_world,
    }


class _View:
    """A 3D View, found again as long as it is there."""

    def __init__(self, area: bpy.types.Area) -> None:
        self._area = area.as_pointer()

    def view(self) -> bpy.types.RegionView3D:
        return self._found().spaces.active.region_3d

    def size(self) -> tuple[int, int]:
        region = next(region for region in self._found().regions if region.type == "WINDOW")
        return max(1, region.width), max(1, region.height)

    def _found(self) -> bpy.types.Area:
        for area in areas("VIEW_3D"):
            if area.as_pointer() == self._area:
                return area
        raise InputError("preview", "the 3D View it looks through was closed", "start it anew from another")


def _show(pixels: np.ndarray, size: tuple[int, int], done: bool) -> None:
    """Put an image into the image; coarse ones are enlarged to `size`."""
    image = preview_image(*size)
    image.pixels.foreach_set(enlarged(pixels, *size))
    image.update()
    _fit(image, size)
    redraw("IMAGE_EDITOR", "VIEW_3D")


_fitted: dict[int, tuple[int, int]] = {}  # Image Editor -> size of the image that fills it; zooming is a person's then


def _fit(image: bpy.types.Image, size: tuple[int, int]) -> None:
    """Let the image fill the editors that show it, once for each of its sizes."""
    for window in bpy.context.window_manager.windows:
        for area in window.screen.areas:
            if area.type == "IMAGE_EDITOR" and area.spaces.active.image == image and _fitted.get(area.as_pointer()) != size:
                region = next(region for region in area.regions if region.type == "WINDOW")
                with bpy.context.temp_override(window=window, area=area, region=region):
                    bpy.ops.image.view_all(fit_view=True)
                _fitted[area.as_pointer()] = size


def preview_image(width: int, height: int) -> bpy.types.Image:
    """The image datablock in this size: linear, premultiplied, shown like a render."""
    image = bpy.data.images.get(IMAGE)
    if image is not None and not (image.is_float and image.source == "GENERATED" and image.library is None):
        image.name = f"{IMAGE} old"  # a person's own of that name
        image = None
    if image is None:
        image = bpy.data.images.new(IMAGE, width, height, alpha=True, float_buffer=True)
        image.alpha_mode, image.use_view_as_render = "PREMUL", True
    if tuple(image.size) != (width, height):
        image.scale(width, height)
    return image


def show_image(context: bpy.types.Context) -> None:
    """Show the image in an Image Editor, one that is open or a window of its own."""
    image = preview_image(*(bpy.data.images[IMAGE].size if IMAGE in bpy.data.images else (256, 256)))
    area = next((area for area in areas("IMAGE_EDITOR") if area.ui_type == "IMAGE_EDITOR"), None)
    if area is None:
        bpy.ops.wm.window_new()
        area = context.window_manager.windows[-1].screen.areas[0]
        area.ui_type = "IMAGE_EDITOR"
    if area.spaces.active.image != image:
        area.spaces.active.image = image
        _fitted.pop(area.as_pointer(), None)
