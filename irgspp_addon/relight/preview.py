# SPDX-License-Identifier: GPL-3.0-or-later
"""Live preview: the relit object as the image "IRGS++ Relight", updated while the user works."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import bpy
import numpy as np

from ...core.errors import InputError
from ...core.scene.camera import Camera
from ..importer.run_frame import Frame, scene_camera, view_camera
from ..windows import areas, enlarged, fit_image, open_image_editor, redraw
from .live_image import Follower, follow, follower_of, stop

IMAGE = "IRGS++ Relight"
CHANNEL = "image"


def start_preview(
    scene: bpy.types.Scene,
    run: Path,
    overrides: dict[str, Any],
    resolution: int | None = None,
    eye: str | None = None,
    area: bpy.types.Area | None = None,
) -> Follower:
    """Start the preview, which follows the scene and its settings from now on.

    Args:
        scene: scene whose World lights the object.
        run: run folder.
        overrides: values that replace those of `settings_of`.
        resolution: longer side of the image in pixels; None for that of the scene's settings.
        eye: "camera" or "view"; None for that of the scene's settings.
        area: 3D View to look from; None for the largest one.

    Raises:
        InputError: if there is no camera or no 3D View to look from.
    """
    place = _Eye(eye, resolution, area)
    place.check(scene)
    follower = Follower(CHANNEL, scene, run, place.camera, place.image_size, lambda scene: {**settings_of(scene), **overrides}, _show)
    follow(follower)
    return follower


def stop_preview() -> None:
    """End the preview; the image stays."""
    stop(CHANNEL)


def preview_running() -> bool:
    """Return True while the image follows the scene."""
    follower = follower_of(CHANNEL)
    return follower is not None and not follower.ended


def preview_message() -> str:
    """Return the preview's progress or the reason of its end as text; "" if there was none."""
    follower = follower_of(CHANNEL)
    return follower.message if follower is not None else ""


def settings_of(scene: bpy.types.Scene) -> dict[str, Any]:
    """Return the scene's settings of relighting: samples, denoise, backend, use_world and use_lamps."""
    settings = scene.irgspp
    return {
        "samples": settings.relight_samples,
        "denoise": settings.relight_denoise,
        "backend": settings.relight_backend,
        "use_world": settings.use_world,
        "use_lamps": settings.use_lamps,
    }


class _Eye:
    """Point of view and size of the image: fixed where they were given, else those of the scene's settings at each update."""

    def __init__(self, eye: str | None, resolution: int | None, area: bpy.types.Area | None) -> None:
        self._eye, self._resolution, self._view = eye, resolution, _View(area)

    def check(self, scene: bpy.types.Scene) -> None:
        """Raise InputError where there is nothing to look from."""
        view = self._view_of(scene)
        if view is not None:
            view.size()
        elif scene.camera is None:
            raise InputError(f"scene {scene.name}", "has no camera", "add one, or look from the 3D View")

    def image_size(self, scene: bpy.types.Scene) -> tuple[int, int]:
        """Return the width and height of the image in pixels."""
        render, view = scene.render, self._view_of(scene)
        width, height = view.size() if view else (render.resolution_x * render.pixel_aspect_x, render.resolution_y * render.pixel_aspect_y)
        scale = (self._resolution or scene.irgspp.preview_resolution) / max(width, height)
        return max(1, round(width * scale)), max(1, round(height * scale))

    def camera(self, scene: bpy.types.Scene, frame: Frame, width: int, height: int) -> Camera:
        """Return the camera in Blender's world.

        Args:
            scene: the scene.
            frame: frame of the object.
            width: width of the image in pixels.
            height: height of the image in pixels.
        """
        view = self._view_of(scene)
        if view is not None:
            return view_camera(view.region_3d(), width, height, frame, view.size())
        # The size is that of the image as shown, so its pixels are square.
        return scene_camera(scene, bpy.context.evaluated_depsgraph_get(), width, height, frame, square=True)

    def _view_of(self, scene: bpy.types.Scene) -> _View | None:
        return self._view if (self._eye or scene.irgspp.relight_eye) == "view" else None


class _View:
    """3D View, which is looked up at each access, since the user may close it; without a given one the largest."""

    def __init__(self, area: bpy.types.Area | None) -> None:
        self._area = area.as_pointer() if area is not None else None

    def region_3d(self) -> bpy.types.RegionView3D:
        return self._find().spaces.active.region_3d

    def size(self) -> tuple[int, int]:
        region = next(region for region in self._find().regions if region.type == "WINDOW")
        return max(1, region.width), max(1, region.height)

    def _find(self) -> bpy.types.Area:
        if self._area is None:
            largest = max(areas("VIEW_3D"), key=lambda area: area.width * area.height, default=None)
            if largest is None:
                raise InputError("preview", "there is no 3D View to look from", "look from the camera")
            self._area = largest.as_pointer()
        for area in areas("VIEW_3D"):
            if area.as_pointer() == self._area:
                return area
        raise InputError("preview", "its 3D View was closed", "start the preview again from another 3D View")


def _show(pixels: np.ndarray, size: tuple[int, int], done: bool) -> None:
    """Write pixels (H, W, 4) into the image datablock, enlarged to `size` (width, height)."""
    image = preview_image(*size)
    image.pixels.foreach_set(enlarged(pixels, *size))
    image.update()
    _fit(image, size)
    redraw("IMAGE_EDITOR", "VIEW_3D")


_fitted: dict[int, tuple[int, int]] = {}  # Image Editor -> size of the image it was fitted to; afterwards the user may zoom


def _fit(image: bpy.types.Image, size: tuple[int, int]) -> None:
    """Fit the view of the Image Editors that show the image, once for each of its sizes."""
    for area in areas("IMAGE_EDITOR"):
        if area.spaces.active.image == image and _fitted.get(area.as_pointer()) != size:
            fit_image(area)
            _fitted[area.as_pointer()] = size


def preview_image(width: int, height: int) -> bpy.types.Image:
    """Return the image datablock of the preview: linear, premultiplied, shown through the view transform like a render.

    Args:
        width: its width in pixels.
        height: its height in pixels.
    """
    image = bpy.data.images.get(IMAGE)
    if image is not None and not (image.is_float and image.source == "GENERATED" and image.library is None):
        image.name = f"{IMAGE} old"  # an image of the user that has this name
        image = None
    if image is None:
        image = bpy.data.images.new(IMAGE, width, height, alpha=True, float_buffer=True)
        image.alpha_mode = "PREMUL"
    image.use_view_as_render = True  # also one that was saved without it: the scene's view transform applies, as to a render
    if tuple(image.size) != (width, height):
        image.scale(width, height)
    return image


def show_image() -> None:
    """Show the image in an open Image Editor, or else in a new window."""
    image = preview_image(*(bpy.data.images[IMAGE].size if IMAGE in bpy.data.images else (256, 256)))
    shown = any(area.spaces.active.image == image for area in areas("IMAGE_EDITOR"))
    area = open_image_editor(image)
    if not shown:
        _fitted.pop(area.as_pointer(), None)
