# SPDX-License-Identifier: GPL-3.0-or-later
"""State of the jobs where it is seen with all panels closed: at the head of the sidebar's tab, and in Blender's status bar."""

from __future__ import annotations

import bpy

from ..irgspp_addon.jobs import queue as jobs
from ..irgspp_addon.jobs.job import Job
from ..irgspp_addon.translations import translated
from .job_card import BEGAN, ICONS
from .phases import total_fraction
from .sidebar import SidebarPanel, button, say

SILENT = ("check",)  # kinds of jobs whose outcome the panel Engine shows


class IRGSPP_PT_headline(SidebarPanel, bpy.types.Panel):
    """Line at the head of the tab, which no closed panel hides: the job is its header.

    Blender puts panels without a header, or with an order below 0, before its own: the tab would jump to the top while a job runs.
    """

    bl_label = ""
    bl_order = 0  # above the panel Engine

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """Return True where a job is unfinished, or the last one failed."""
        return headline() is not None

    def draw_header(self, context: bpy.types.Context) -> None:
        """Draw the job in one line."""
        job = headline()
        if job is not None:
            _draw_line(self.layout, headline_text(job), job)

    def draw(self, context: bpy.types.Context) -> None:
        """Draw the error of a job that failed."""
        job = headline()
        if job is None or not is_trouble(job):
            return
        column = self.layout.column()
        column.alert = True
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
        return translated("{job}: result not used" if job.state == "done" else "{job} failed", job=job.title)
    if job.state == "queued":
        return translated("{job} waits", job=job.title)
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
        _draw_line(self.layout, f"IRGS++: {headline_text(job)}", job)


def _draw_line(layout: bpy.types.UILayout, text: str, job: Job) -> None:
    row = layout.row()
    row.alert = is_trouble(job)
    row.label(text=text, icon="ERROR" if is_trouble(job) else ICONS[job.state])


CLASSES = (IRGSPP_PT_headline,)
