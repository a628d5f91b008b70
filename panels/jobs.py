# SPDX-License-Identifier: GPL-3.0-or-later
"""Panel of all jobs, newest first, with the card of the selected one."""

from __future__ import annotations

import time
from typing import Any

import bpy

from ..irgspp_addon.jobs import queue as jobs
from ..irgspp_addon.jobs.job import Job
from ..irgspp_addon.translations import translated
from .job_card import ICONS, draw_job
from .sidebar import SidebarPanel, button, say


class IRGSPP_UL_jobs(bpy.types.UIList):
    """List of jobs: title, and progress or time of the end."""

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
        """Draw one row.

        Args:
            context: of the panel.
            layout: to draw into.
            data: owner of the list.
            item: row, named by the id of its job.
            icon: unused.
            active_data: owner of the active row's number.
            active_property: name of that number.
        """
        job = jobs.find(item.name)
        if job is None:  # removed from another window; the list is updated in a moment
            return
        row = layout.row(align=True)
        row.label(text=job.title, icon=ICONS[job.state])
        when = row.row()
        when.alignment = "RIGHT"
        when.label(text=job_when(job))

    def filter_items(self, context: bpy.types.Context, data: Any, property: str) -> tuple[list[int], list[int]]:
        """Return flags of the rows whose job title contains the search text, and no order.

        Args:
            context: of the panel.
            data: owner of the list.
            property: name of the list.
        """
        search = self.filter_name.lower()
        titles = [job.title.lower() if (job := jobs.find(item.name)) else "" for item in getattr(data, property)]
        return [self.bitflag_filter_item if search in title else 0 for title in titles], []


class IRGSPP_PT_jobs(SidebarPanel, bpy.types.Panel):
    """Panel of running, waiting and finished jobs."""

    bl_label = "Jobs"
    bl_order = 7
    bl_options = {"DEFAULT_CLOSED"}  # noqa: RUF012 (Blender wants a plain set)

    def draw_header_preset(self, context: bpy.types.Context) -> None:
        """Draw the number of unfinished jobs in the header."""
        busy = sum(not job.finished for job in jobs.all_jobs())
        if busy:
            self.layout.label(text=translated("{count} unfinished", count=busy))

    def draw(self, context: bpy.types.Context) -> None:
        """Draw the list and the card of the selected job."""
        layout, manager = self.layout, context.window_manager
        if not len(manager.irgspp_jobs):
            say(layout, context, "No jobs yet.")
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
    """Return the job of the selected row; None where there is none."""
    index = manager.irgspp_job_index
    return jobs.find(manager.irgspp_jobs[index].name) if 0 <= index < len(manager.irgspp_jobs) else None


def job_when(job: Job) -> str:
    """Return "46 %" while a job runs, "14:05" where it ended today, "20 Nov" where it ended before."""
    if job.state == "running":
        return f"{100 * job.fraction:.0f} %" if job.of else ""
    if not job.ended:
        return ""
    ended, today = time.localtime(job.ended), time.localtime()
    return time.strftime("%H:%M" if ended[:3] == today[:3] else "%d %b", ended)


CLASSES = (IRGSPP_UL_jobs, IRGSPP_PT_jobs)
