# SPDX-License-Identifier: GPL-3.0-or-later
"""Panel of step 1: choose photographs, and see what is there."""

from __future__ import annotations

import json
from functools import lru_cache
from pathlib import Path
from typing import Any

import bpy

from ..irgspp_addon.engine import process as engine
from ..irgspp_addon.importer.photographs import BarePhotographs
from ..irgspp_addon.jobs import queue as jobs
from ..irgspp_addon.jobs.job import Job
from ..irgspp_addon.translations import translated
from .capture_state import bare_photographs, cameras_missing, capture_of, problem_of, thumbnails
from .images import image
from .run_state import resolved
from .sidebar import SidebarPanel, button, say
from .steps import PHOTOGRAPHS, StepPanel

THUMBNAIL = 3.2  # height of a photograph in rows of buttons
SHOWN = ("format", "views", "images", "masks", "points")  # rows of an inspection that the panel shows
ENOUGH = 20  # photographs below which the panel asks for more


class IRGSPP_PT_photographs(StepPanel, SidebarPanel, bpy.types.Panel):
    """Panel of the photographs."""

    bl_label = "1 Photographs"
    bl_order = 2
    step = PHOTOGRAPHS

    def draw(self, context: bpy.types.Context) -> None:
        """Draw the folder and what is in it, or the guide where no folder is chosen."""
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
        bare = bare_photographs(dataset)
        if bare is not None:
            draw_count(layout, context, bare)
        elif not cameras_missing(dataset, capture_of(dataset)):
            row = layout.row()
            row.enabled = not problem and engine.status().usable
            button(row, "irgspp.inspect_dataset", "Inspect", "VIEWZOOM", directory=str(dataset))
        draw_inspection(layout, context, last_inspection(dataset))
        draw_summary(layout, context, settings.inspected)


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


def draw_count(layout: bpy.types.UILayout, context: bpy.types.Context, bare: BarePhotographs) -> None:
    """Draw the number of photographs without cameras, and a warning where they are few.

    Args:
        layout: to draw into.
        context: of the panel.
        bare: photographs and videos of the chosen folder.
    """
    say(layout, context, translated("Photographs without cameras: {count}", count=count_in_words(bare)), icon="INFO")
    if bare.complete and not bare.videos and bare.photographs < ENOUGH:
        say(layout, context, translated("That is few: {count} or more from all around give a good object.", count=ENOUGH), icon="ERROR")


def count_in_words(bare: BarePhotographs) -> str:
    """Return the number of photographs and videos as "23 files" or "1 video, 3 files"."""
    words = (bare.videos, "1 video", "{count} videos"), (bare.photographs, "1 file", "{count} files")
    text = ", ".join(translated(one if count == 1 else several, count=count) for count, one, several in words if count)
    return text if bare.complete else translated("{count} and more", count=text)


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
        layout.progress(factor=job.fraction, text=translated("Reading the photographs"))
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
    rows = [(name, text) for name, text in facts.get("rows", ()) if name in SHOWN]
    if not rows and not facts.get("warnings"):
        return
    box = layout.box()
    column = box.column(align=True)
    for name, text in rows:
        row = column.split(factor=0.27)
        say(row, context, name.capitalize())
        say(row, context, text, width=0.73)
    for warning in facts["warnings"]:
        say(box, context, warning, icon="ERROR")


@lru_cache(maxsize=4)
def parsed(inspected: str) -> dict[str, Any]:
    """Return the summary of an inspection from JSON; empty without one."""
    return json.loads(inspected) if inspected else {}


CLASSES = (IRGSPP_PT_photographs,)
