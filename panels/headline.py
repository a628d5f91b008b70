# SPDX-License-Identifier: GPL-3.0-or-later
"""State of the jobs where it is seen with all panels closed: at the head of the sidebar's tab, and in Blender's status bar."""

from __future__ import annotations

import bpy

from ..irgspp_addon.jobs import queue as jobs
from ..irgspp_addon.jobs.job import Job
from .job_card import BEGAN, ICONS
from .phases import total_fraction
from .sidebar import SidebarPanel, button, say

SILENT = ("check",)  # kinds of jobs whose outcome the panel Engine shows


class IRGSPP_PT_headline(SidebarPanel, bpy.types.Panel):
    """Line at the head of the tab, which no closed panel hides."""

    bl_label = "State"
    bl_order = -1  # above the panel Engine
    bl_options = {"HIDE_HEADER"}  # noqa: RUF012 (Blender wants a plain set)

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """Return True where a job is unfinished, or the last one failed."""
        return headline() is not None

    def draw(self, context: bpy.types.Context) -> None:
        """Draw the job in one line, and its error."""
        job = headline()
        if job is None:
            return
        column = self.layout.column()
        column.alert = is_trouble(job)
        say(column, context, headline_text(job), icon="ERROR" if is_trouble(job) else ICONS[job.state])
        if is_trouble(job):
            say(column, context, job.error or "It ended without a message.")
            button(self.layout, "irgspp.job_log", "Open Log", "TEXT", job=job.id)


def headline() -> Job | None:
    """Return the job to show: the running one, else one that waits, else the one that ended last in this session if it failed."""
    shown = [job for job in jobs.all_jobs() if job.kind not in SILENT]
    unfinished = [job for job in reversed(shown) if not job.finished]
    if unfinished:
        return next((job for job in unfinished if job.state == "running"), unfinished[0])
    last = max((job for job in shown if (job.ended or 0.0) > BEGAN), key=lambda job: job.ended or 0.0, default=None)
    return last if last is not None and is_trouble(last) else None


def is_trouble(job: Job) -> bool:
    """Return True for a job that failed, or whose result could not be used."""
    return job.state in ("failed", "lost") or (job.state == "done" and bool(job.error))


def headline_text(job: Job) -> str:
    """Return a job and its state, such as "Reconstruct spot, 46 %": of the whole reconstruction, of the present step for other jobs."""
    if is_trouble(job):
        return f"{job.title}: result not used" if job.state == "done" else f"{job.title} failed"
    if job.state == "queued":
        return f"{job.title} waits"
    whole = total_fraction(job.kind, job.phase, job.fraction)
    if whole is None and not job.of:
        return job.title
    return f"{job.title}, {100 * (job.fraction if whole is None else whole):.0f} %"


def draw_status(self: bpy.types.Header, context: bpy.types.Context) -> None:
    """Add the state of the jobs to Blender's status bar.

    Args:
        self: status bar.
        context: of the status bar.
    """
    job = headline()
    if job is not None:
        row = self.layout.row()
        row.alert = is_trouble(job)
        row.label(text=f"IRGS++: {headline_text(job)}", icon="ERROR" if is_trouble(job) else ICONS[job.state])


CLASSES = (IRGSPP_PT_headline,)
