# SPDX-License-Identifier: GPL-3.0-or-later
"""The reconstruction: what is asked for, the button, and how far it is."""

from __future__ import annotations

from pathlib import Path

import bpy

from ..irgspp_addon.engine import process as engine
from ..irgspp_addon.jobs import queue as jobs
from ..irgspp_addon.jobs.job import Job
from .job_card import BEGAN, RECONSTRUCTIONS, can_go_on, draw_job
from .run_state import resolved, run_state
from .sidebar import SidebarPanel, button, say, settings_column

STOPPED = ("running", "failed", "cancelled")  # states of a run folder that can be gone on with; "running" where nothing runs any more


class IRGSPP_PT_reconstruct(SidebarPanel, bpy.types.Panel):
    """Photographs to an object with materials"""

    bl_label = "Reconstruct"
    bl_order = 2

    def draw(self, context: bpy.types.Context) -> None:
        layout, settings = self.layout, context.scene.irgspp
        column = settings_column(layout)
        for name in ("preset", "materials", "device"):
            column.prop(settings, name)
        job = present_job(settings.run_path())
        if job is None or job.finished:  # else all there is to do is in the job's box
            draw_start(layout, context, job)
        if job is not None:
            box = layout.box()
            if job.kind == "demo":
                box.label(text=job.title)  # it is not of the photographs chosen above
            draw_job(box, context, job)


class IRGSPP_PT_reconstruct_more(SidebarPanel, bpy.types.Panel):
    """Where the run is written, and single settings"""

    bl_label = "More"
    bl_parent_id = "IRGSPP_PT_reconstruct"
    bl_options = {"DEFAULT_CLOSED"}  # noqa: RUF012 (Blender wants a plain set)

    def draw(self, context: bpy.types.Context) -> None:
        column = settings_column(self.layout)
        for name in ("run", "seed", "overrides", "import_result"):
            column.prop(context.scene.irgspp, name)


def draw_start(layout: bpy.types.UILayout, context: bpy.types.Context, job: Job | None) -> None:
    """The buttons; where they can't be pressed, words say why."""
    settings = context.scene.irgspp
    status = run_state(settings.run_path()).status if settings.dataset else ""
    row = layout.row(align=True)
    row.scale_y = 1.5
    row.enabled = bool(settings.dataset) and engine.status().usable
    if status in STOPPED and not (job and can_go_on(job)):  # else the job itself offers it
        button(row, "irgspp.reconstruct", "Go On", "FILE_REFRESH", resume=True)
    button(row, "irgspp.reconstruct", "Reconstruct Again" if status else "Reconstruct", "PLAY", overwrite=bool(status))
    if not settings.dataset:
        say(layout, context, "Choose photographs above first.", icon="INFO")
    elif not engine.status().usable:
        say(layout, context, "Set up the engine above first.", icon="INFO")
    elif status:
        say(layout, context, "Starting anew replaces the run in the folder.", icon="INFO")


def present_job(run: Path | None) -> Job | None:
    """The reconstruction that is under way, or else the last one of this run folder; without one, a demonstration of this session."""
    reconstructions = [job for job in jobs.all_jobs() if job.kind in RECONSTRUCTIONS]
    under_way = [job for job in reconstructions if not job.finished]
    if run is None:
        last = [job for job in reconstructions if job.kind == "demo" and job.made > BEGAN]
    else:
        last = [job for job in reconstructions if resolved(job.folder) == resolved(run)]
    return next(iter([*reversed(under_way), *last]), None)


CLASSES = (IRGSPP_PT_reconstruct, IRGSPP_PT_reconstruct_more)
