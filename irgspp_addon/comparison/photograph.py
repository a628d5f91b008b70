# SPDX-License-Identifier: GPL-3.0-or-later
"""Photograph that the object is compared with: it is faded over the object, or shown beside it, left of a border."""

from __future__ import annotations

import bpy
from bpy.props import EnumProperty, FloatProperty

from .. import shared_properties as shared
from ..importer.arrangement import is_imported_camera
from ..importer.cameras import BEHIND


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


def border(scene: bpy.types.Scene) -> float:
    """Return the place of the border between photograph and result, as a fraction of the image's width; 0 where no photograph is shown."""
    return scene.irgspp_border if scene.irgspp_comparison == "split" and shown_photograph(scene) is not None else 0.0


def _chosen(scene: bpy.types.Scene, context: bpy.types.Context) -> None:
    """Put the photograph behind the object where it is shown beside it from now on."""
    if scene.irgspp_comparison == "split":
        fade(scene, 0.0)


def register() -> None:
    """Add the properties. That of the opacity stores nothing: it reads and changes the camera's background image."""
    bpy.types.Scene.irgspp_comparison = EnumProperty(**shared.COMPARISON, update=_chosen)
    bpy.types.Scene.irgspp_border = FloatProperty(**shared.BORDER)
    bpy.types.Scene.irgspp_photograph = FloatProperty(**shared.OPACITY, get=opacity, set=fade)


def unregister() -> None:
    """Remove the properties."""
    del bpy.types.Scene.irgspp_photograph
    del bpy.types.Scene.irgspp_border
    del bpy.types.Scene.irgspp_comparison
