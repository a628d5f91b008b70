# SPDX-License-Identifier: GPL-3.0-or-later
"""Panel of step 2: find or import the cameras, and check them and the object that is cut out."""

from __future__ import annotations

from pathlib import Path

import bpy

from ..irgspp_addon.engine import process as engine
from ..irgspp_addon.importer.arrangement import is_imported_camera
from ..irgspp_addon.importer.capture_file import CaptureSummary
from ..irgspp_addon.importer.mask_image import is_captured_camera
from ..irgspp_addon.importer.object_sphere import find_sphere, is_changed
from ..irgspp_addon.properties import beside
from ..irgspp_addon.translations import translated
from .capture import draw_capture, draw_find_cameras
from .capture_state import cameras_missing, capture_of
from .job_card import draw_last
from .photographs import parsed
from .run_state import resolved
from .sidebar import SidebarPanel, button, say, settings_column
from .steps import CAMERAS, PHOTOGRAPHS, StepPanel, done_steps, obstacle


class IRGSPP_PT_cameras(StepPanel, SidebarPanel, bpy.types.Panel):
    """Panel of the cameras and the object."""

    bl_label = "2 Cameras and Object"
    bl_order = 3
    step = CAMERAS

    def draw(self, context: bpy.types.Context) -> None:
        """Draw the buttons that find, import and correct cameras and object, or why there is nothing to check yet."""
        layout, settings = self.layout, context.scene.irgspp
        dataset = settings.dataset_path()
        if reason := obstacle(context, CAMERAS):
            say(layout, context, reason, icon="INFO")
        if dataset is None or PHOTOGRAPHS not in done_steps(context):
            return
        capture = capture_of(dataset)
        if cameras_missing(dataset, capture):
            draw_find_cameras(layout, context, dataset, capture)
        else:
            draw_import(layout, settings, str(dataset))
        draw_cut_out(layout, context, dataset, settings.inspected, capture)
        draw_capture(layout, context, dataset, capture)
        draw_sphere(layout, context, dataset)
        draw_camera(layout, context.object)


class IRGSPP_PT_import_options(SidebarPanel, bpy.types.Panel):
    """Panel of the options for the import of cameras and points."""

    bl_label = "Import Options"
    bl_parent_id = "IRGSPP_PT_cameras"
    bl_options = {"DEFAULT_CLOSED"}  # noqa: RUF012 (Blender wants a plain set)

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """Return True where photographs are chosen."""
        return PHOTOGRAPHS in done_steps(context)

    def draw(self, context: bpy.types.Context) -> None:
        """Draw the options."""
        column = settings_column(self.layout)
        for name in ("up_axis", "scale", "recentre", "with_photographs", "with_points"):
            column.prop(context.scene.irgspp, name)


def draw_import(layout: bpy.types.UILayout, settings: bpy.types.PropertyGroup, dataset: str) -> None:
    """Draw the button that imports the cameras and points of a dataset.

    Args:
        layout: to draw into.
        settings: of the scene.
        dataset: path of the dataset.
    """
    row = layout.row()
    row.enabled = engine.status().usable
    button(
        row,
        "irgspp.import_dataset",
        "Import Cameras",
        "CAMERA_DATA",
        directory=dataset,
        up_axis=settings.up_axis,
        scale=settings.scale,
        recentre=settings.recentre,
        photographs=settings.with_photographs,
        points=settings.with_points,
    )


def draw_cut_out(
    layout: bpy.types.UILayout, context: bpy.types.Context, dataset: Path, inspected: str, capture: CaptureSummary | None
) -> None:
    """Draw the button that cuts the object out of photographs that have cameras and no masks.

    Args:
        layout: to draw into.
        context: of the panel.
        dataset: that the user chose.
        inspected: summary of the dataset as JSON; empty without one.
        capture: summary of its capture.json; None without one.
    """
    facts = parsed(inspected)
    if capture is not None or not facts or "none" not in (text for name, text in facts["rows"] if name == "masks"):
        return
    say(layout, context, "Without masks, the surroundings are reconstructed, too.", icon="INFO")
    column = layout.column()
    column.enabled = engine.status().usable
    button(column, "irgspp.capture", "Cut Out the Object", "MOD_MASK", directory=str(dataset), marker=0.0, turntable="auto")
    draw_last(layout, context, "capture", beside(resolved(dataset) or dataset, "_capture"))


def draw_sphere(layout: bpy.types.UILayout, context: bpy.types.Context, dataset: Path) -> None:
    """Draw what the sphere around the object is for, while it is shown and where the user has not changed it.

    Args:
        layout: to draw into.
        context: of the panel.
        dataset: that the user chose.
    """
    sphere = find_sphere(context.scene, resolved(dataset))
    if sphere is not None and not is_changed(sphere) and not sphere.hide_viewport:
        text = translated('Move or scale the sphere "{name}" if it does not surround the object.', name=sphere.name)
        say(layout, context, text, icon="SPHERE")


def draw_camera(layout: bpy.types.UILayout, thing: bpy.types.Object | None) -> None:
    """Draw the buttons that look through the selected camera and edit the mask of its photograph.

    Args:
        layout: to draw into.
        thing: active object; None without one.
    """
    if thing is None or not is_imported_camera(thing):
        return
    button(layout, "irgspp.look_through", translated("Look Through {name}", name=thing.name), "VIEW_CAMERA", camera=thing.name)
    if is_captured_camera(thing):
        button(layout, "irgspp.edit_mask", "Edit Mask", "BRUSH_DATA", camera=thing.name)


CLASSES = (IRGSPP_PT_cameras, IRGSPP_PT_import_options)
