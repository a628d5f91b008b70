# SPDX-License-Identifier: GPL-3.0-or-later
"""Comparison of the object with a photograph, seen through its camera: the photograph is faded over the object."""

from __future__ import annotations

import bpy
from bpy.props import FloatProperty

from .arrangement import is_imported_camera
from .cameras import BEHIND


def shown_photograph(scene: bpy.types.Scene) -> bpy.types.CameraBackgroundImage | None:
    """Return the photograph of the imported camera that the scene is seen through; None without one."""
    camera = scene.camera
    if not is_imported_camera(camera) or not camera.data.show_background_images:
        return None
    return next((shown for shown in camera.data.background_images if shown.image is not None), None)


def opacity(scene: bpy.types.Scene) -> float:
    """Return the opacity of the photograph over the object; 0 where it is behind it or there is none."""
    shown = shown_photograph(scene)
    return shown.alpha if shown is not None and shown.display_depth == "FRONT" else 0.0


def fade(scene: bpy.types.Scene, value: float) -> None:
    """Show the photograph over the object with an opacity; with 0, behind it."""
    shown = shown_photograph(scene)
    if shown is not None:
        shown.display_depth = "FRONT" if value else "BACK"
        shown.alpha = value or BEHIND


def register() -> None:
    """Add the property of the slider, which stores nothing: it reads and changes the camera's background image."""
    bpy.types.Scene.irgspp_photograph = FloatProperty(
        name="Photograph over Object",
        description="Opacity of the photograph in front of the object, seen through its camera: 0 shows the object, 1 the photograph",
        subtype="FACTOR",
        min=0.0,
        max=1.0,
        get=opacity,
        set=fade,
    )


def unregister() -> None:
    """Remove the property."""
    del bpy.types.Scene.irgspp_photograph
