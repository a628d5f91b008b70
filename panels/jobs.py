# SPDX-License-Identifier: GPL-3.0-or-later
"""All jobs, the newest first, and the details of the one that is chosen."""

from __future__ import annotations

import time
from typing import Any

import bpy

from ..irgspp_addon.jobs import queue as jobs
from ..irgspp_addon.jobs.job import Job
from .job_card import ICONS, draw_job
from .sidebar import SidebarPanel, button, say


class IRGSPP_UL_jobs(bpy.types.UIList):
    """Title, and how far it is or when it ended."""

    def draw_item(
        self,
        context: bpy.types.Context,
        layout: bpy.types.UILayout,
        data: Any,
        item: Any,
        icon: int,
        active_data: Any,
        active_property: str,
    ) -> None:
        job = jobs.find(item.name)
        if job is None:  # forgotten by another window; the list follows in a moment
            return
        row = layout.row(align=True)
        row.label(text=job.title, icon=ICONS[job.state])
        when = row.row()
        when.alignment = "RIGHT"
        when.label(text=job_when(job))

    def filter_items(self, context: bpy.types.Context, data: Any, property: str) -> tuple[list[int], list[int]]:
        wanted = self.filter_name.lower()
        titles = [job.title.lower() if (job := jobs.find(item.name)) else "" for item in getattr(data, property)]
        return [self.bitflag_filter_item if wanted in title else 0 for title in titles], []


class IRGSPP_PT_jobs(SidebarPanel, bpy.types.Panel):
    """What runs, waits and has been done"""

    bl_label = "Jobs"
    bl_order = 5
    bl_options = {"DEFAULT_CLOSED"}  # noqa: RUF012 (Blender wants a plain set)

    def draw_header_preset(self, context: bpy.types.Context) -> None:
        busy = sum(not job.finished for job in jobs.all_jobs())
        if busy:
            self.layout.label(text=f"{busy} under way")

    def draw(self, context: bpy.types.Context) -> None:
        layout, manager = self.layout, context.window_manager
        if not len(manager.irgspp_jobs):
            say(layout, context, "Nothing was started yet.")
            return
        layout.template_list("IRGSPP_UL_jobs", "", manager, "irgspp_jobs", manager, "irgspp_job_index", rows=3)
        job = chosen_job(manager)
        if job is None:
            return
        box = layout.box()
        draw_job(box, context, job)
        say(box, context, str(job.folder), icon="FILE_FOLDER")
        if job.finished:
            button(box, "irgspp.job_forget", "Remove from List", "TRASH", job=job.id)


def chosen_job(manager: bpy.types.WindowManager) -> Job | None:
    """The job of the list's active row."""
    index = manager.irgspp_job_index
    return jobs.find(manager.irgspp_jobs[index].name) if 0 <= index < len(manager.irgspp_jobs) else None


def job_when(job: Job) -> str:
    """46 % while it runs; 14:05 today, 20 Nov before."""
    if job.state == "running":
        return f"{100 * job.fraction:.0f} %" if job.of else ""
    if not job.ended:
        return ""
    ended, today = time.localtime(job.ended), time.localtime()
    return time.strftime("%H:%M" if ended[:3] == today[:3] else "%d %b", ended)


CLASSES = (IRGSPP_UL_jobs, IRGSPP_PT_jobs)
