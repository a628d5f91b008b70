# SPDX-License-Identifier: GPL-3.0-or-later
"""Blender's windows: finding and redrawing their areas, and resizing images for display."""

from __future__ import annotations

from collections.abc import Collection, Iterator
from contextlib import AbstractContextManager
from typing import Any

import bpy
import numpy as np

WITH_SIDEBAR = ("VIEW_3D", "IMAGE_EDITOR")  # types of areas whose panels are in a sidebar


def areas(*kinds: str) -> Iterator[bpy.types.Area]:
    """Yield the areas of these types (such as "VIEW_3D") in all windows; none in background mode."""
    manager = bpy.context.window_manager
    for window in manager.windows if manager else ():
        yield from (area for area in window.screen.areas if area.type in kinds)


def redraw(*kinds: str) -> None:
    """Redraw all areas of these types."""
    for area in areas(*kinds):
        area.tag_redraw()


def redraw_panels(*kinds: str) -> None:
    """Redraw the panels in the areas of these types: of editors with a sidebar that alone, as drawing a scene may take long."""
    for area in areas(*kinds):
        for region in area.regions:
            if region.type == "UI" or area.type not in WITH_SIDEBAR:
                region.tag_redraw()


def redraw_status_bar() -> None:
    """Redraw the status bar, which is no area of the screen: it listens for a renamed view layer."""
    bpy.msgbus.publish_rna(key=(bpy.types.ViewLayer, "name"))


def open_image_editor(image: bpy.types.Image) -> bpy.types.Area:
    """Show an image in an open Image Editor, or else in a new window, and return the editor's area."""
    area = next((area for area in areas("IMAGE_EDITOR") if area.ui_type == "IMAGE_EDITOR"), None)
    if area is None:
        bpy.ops.wm.window_new()
        area = bpy.context.window_manager.windows[-1].screen.areas[0]
        area.ui_type = "IMAGE_EDITOR"
    if area.spaces.active.image != image:
        area.spaces.active.image = image
    return area


def in_area(area: bpy.types.Area) -> AbstractContextManager[Any]:
    """Return a context override for operators in the main region of an area."""
    window = next(one for one in bpy.context.window_manager.windows if area in one.screen.areas[:])
    region = next(region for region in area.regions if region.type == "WINDOW")
    return bpy.context.temp_override(window=window, area=area, region=region)


def fit_image(area: bpy.types.Area) -> None:
    """Fit the view of an Image Editor to its image."""
    with in_area(area):
        bpy.ops.image.view_all(fit_view=True)


def enlarged(image: np.ndarray, width: int, height: int) -> np.ndarray:
    """Resize an image by nearest neighbour and return its pixels in Blender's order.

    Args:
        image: (H, W, 4) pixels, top row first.
        width: width of the result in pixels.
        height: height of the result in pixels.

    Returns:
        (height * width * 4,) float32, bottom row first.
    """
    rows = np.arange(height - 1, -1, -1) * len(image) // height
    columns = np.arange(width) * image.shape[1] // width
    return np.ascontiguousarray(image[rows][:, columns], np.float32).reshape(-1)


def show_selected(scene: bpy.types.Scene, materials: bool = True) -> None:
    """Frame the selected objects in the 3D Views of a scene.

    Args:
        scene: scene of the objects.
        materials: switch views in Solid shading to Material Preview, whose shaders Blender compiles for seconds the first time.
    """
    for area in _views_of(scene):
        space = area.spaces.active
        if materials and space.shading.type == "SOLID":
            space.shading.type = "MATERIAL"
        if space.region_3d.view_perspective == "CAMERA":
            space.region_3d.view_perspective = "PERSP"
        with in_area(area):
            bpy.ops.view3d.view_selected(use_all_regions=False)


def show_world(scene: bpy.types.Scene) -> list[str]:
    """Light the Material Preview of a scene's 3D Views by its World, which the user has just chosen, instead of Blender's studio light.

    Returns:
        Names of the views that were changed, for `show_studio_light`.
    """
    changed = [area for area in _views_of(scene) if _studio_lit(area)]
    for area in changed:
        area.spaces.active.shading.use_scene_world = True
    return [_view_name(area) for area in changed]


def show_studio_light(scene: bpy.types.Scene, views: Collection[str]) -> None:
    """Light the Material Preview of 3D Views by Blender's studio light again.

    Args:
        scene: scene of the views.
        views: their names, from `show_world`.
    """
    for area in _views_of(scene):
        if _view_name(area) in views:
            area.spaces.active.shading.use_scene_world = False


def _studio_lit(area: bpy.types.Area) -> bool:
    shading = area.spaces.active.shading
    return shading.type == "MATERIAL" and not shading.use_scene_world


def _view_name(area: bpy.types.Area) -> str:
    """Return a name of an area that holds when the file is opened again: its screen's, and its place in there."""
    return f"{area.id_data.name}/{area.id_data.areas[:].index(area)}"


def _views_of(scene: bpy.types.Scene) -> Iterator[bpy.types.Area]:
    """Yield the 3D Views of the windows that show a scene; none in background mode."""
    for window in bpy.context.window_manager.windows if bpy.context.window_manager else ():
        if window.scene == scene:
            yield from (area for area in window.screen.areas if area.type == "VIEW_3D")
