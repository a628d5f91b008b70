# SPDX-License-Identifier: GPL-3.0-or-later
"""Panel of the dataset: its folder, its inspection, and its import into the scene."""

from __future__ import annotations

import json
from functools import lru_cache
from pathlib import Path
from typing import Any

import bpy

from ..irgspp_addon.engine import process as engine
from ..irgspp_addon.importer.arrangement import is_imported_camera
from ..irgspp_addon.importer.capture_file import CaptureSummary
from ..irgspp_addon.importer.mask_image import is_captured_camera
from ..irgspp_addon.jobs import queue as jobs
from ..irgspp_addon.jobs.job import Job
from ..irgspp_addon.properties import beside
from .capture import draw_capture, draw_find_cameras
from .capture_state import capture_of, problem_of, thumbnails
from .images import image
from .job_card import draw_last
from .run_state import resolved
from .sidebar import SidebarPanel, button, say, settings_column

THUMBNAIL = 3.2  # height of a photograph in rows of buttons
SHOWN = ("format", "views", "images", "masks", "points")  # rows of an inspection that the panel shows


class IRGSPP_PT_dataset(SidebarPanel, bpy.types.Panel):
    """Panel of the photographs and their cameras."""

    bl_label = "Dataset"
    bl_order = 2

    def draw(self, context: bpy.types.Context) -> None:
        """Draw the folder, the buttons, the inspection, and the guide where no folder is chosen."""
        layout, settings = self.layout, context.scene.irgspp
        row = layout.row(align=True)
        row.prop(settings, "dataset", text="")
        button(row, "irgspp.choose_video", "", "FILE_MOVIE")
        dataset = settings.dataset_path()
        if dataset is None:
            draw_guide(layout, context)
            return
        problem = problem_of(dataset)
        if problem:
            column = layout.column()
            column.alert = True
            say(column, context, problem, icon="ERROR")
        draw_thumbnails(layout, dataset)
        capture = capture_of(dataset)
        if not draw_find_cameras(layout, context, dataset, capture):
            draw_import(layout, settings, str(dataset), not problem)
        draw_inspection(layout, context, last_inspection(dataset))
        draw_summary(layout, context, settings.inspected)
        draw_cut_out(layout, context, dataset, settings.inspected, capture)
        draw_capture(layout, context, dataset, capture)
        if is_imported_camera(context.object):
            button(layout, "irgspp.look_through", f"Look Through {context.object.name}", "VIEW_CAMERA", camera=context.object.name)
            if is_captured_camera(context.object):
                button(layout, "irgspp.edit_mask", "Edit Mask", "BRUSH_DATA", camera=context.object.name)


class IRGSPP_PT_import_options(SidebarPanel, bpy.types.Panel):
    """Panel of the options for the import of cameras and points."""

    bl_label = "Import Options"
    bl_parent_id = "IRGSPP_PT_dataset"
    bl_options = {"DEFAULT_CLOSED"}  # noqa: RUF012 (Blender wants a plain set)

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """Return True where a dataset is chosen."""
        return bool(context.scene.irgspp.dataset)

    def draw(self, context: bpy.types.Context) -> None:
        """Draw the options."""
        column = settings_column(self.layout)
        for name in ("up_axis", "scale", "recentre", "with_photographs", "with_points"):
            column.prop(context.scene.irgspp, name)


def draw_guide(layout: bpy.types.UILayout, context: bpy.types.Context) -> None:
    """Draw the first steps, for a new user.

    Args:
        layout: to draw into.
        context: of the panel.
    """
    box = layout.box()
    say(box, context, "From photographs of one object to an object that can be relit:")
    say(box, context, "Choose a folder of photographs, or a video. Known cameras are used, others are found.", "FILE_FOLDER")
    say(box, context, "Press Reconstruct; you can go on working in Blender.", "PLAY")
    say(box, context, "Relight the object with any World.", "WORLD")
    column = layout.column()
    column.scale_y = 1.3
    column.enabled = engine.status().usable  # else the panel above explains what to do
    button(column, "irgspp.demo", "Try the Demo", "MONKEY")


def draw_thumbnails(layout: bpy.types.UILayout, dataset: Path) -> None:
    """Draw a few of the photographs.

    Args:
        layout: to draw into.
        dataset: folder that the user chose.
    """
    row = layout.row(align=True)
    for photograph in thumbnails(dataset):
        image(row, photograph, scale=THUMBNAIL)


def draw_import(layout: bpy.types.UILayout, settings: bpy.types.PropertyGroup, dataset: str, enabled: bool) -> None:
    """Draw the buttons that inspect and import a dataset.

    Args:
        layout: to draw into.
        settings: of the scene.
        dataset: path of the dataset.
        enabled: False where there is nothing to read.
    """
    row = layout.row(align=True)
    row.enabled = enabled and engine.status().usable
    button(row, "irgspp.inspect_dataset", "Inspect", "VIEWZOOM", directory=dataset)
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


def draw_inspection(layout: bpy.types.UILayout, context: bpy.types.Context, job: Job | None) -> None:
    """Draw the progress of an inspection, or its error.

    Args:
        layout: to draw into.
        context: of the panel.
        job: inspection of the dataset; None without one.
    """
    if job is None:
        return
    if not job.finished:
        layout.progress(factor=job.fraction, text="Reading the photographs")
    elif job.error and not changed_since(Path(job.data["dataset"]), job.ended):
        column = layout.column()
        column.alert = True
        say(column, context, job.error, icon="ERROR")


def changed_since(folder: Path, when: float | None) -> bool:
    """Return True if a folder has got or lost files since a time, in seconds since the epoch."""
    try:
        return when is not None and folder.stat().st_mtime > when
    except OSError:
        return False


def last_inspection(dataset: Path | None) -> Job | None:
    """Return the last job that read this dataset for the panel or for an import."""
    folder = str(resolved(dataset))
    return next((job for job in jobs.all_jobs() if job.kind == "inspect" and job.data.get("dataset") == folder), None)


def draw_summary(layout: bpy.types.UILayout, context: bpy.types.Context, inspected: str) -> None:
    """Draw the summary of a dataset and its warnings.

    Args:
        layout: to draw into.
        context: of the panel.
        inspected: summary as JSON; empty without one.
    """
    facts = parsed(inspected)
    if not facts:
        return
    box = layout.box()
    column = box.column(align=True)
    for name, text in facts["rows"]:
        if name in SHOWN:
            row = column.split(factor=0.27)
            say(row, context, name.capitalize())
            say(row, context, text, width=0.73)
    for warning in facts["warnings"]:
        say(box, context, warning, icon="ERROR")


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


@lru_cache(maxsize=4)
def parsed(inspected: str) -> dict[str, Any]:
    """Return the summary of an inspection from JSON; empty without one."""
    return json.loads(inspected) if inspected else {}


CLASSES = (IRGSPP_PT_dataset, IRGSPP_PT_import_options)
