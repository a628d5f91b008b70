# SPDX-License-Identifier: GPL-3.0-or-later
"""One job as a person sees it: what it does, how far it is, what can be done with it."""

from __future__ import annotations

import time
from pathlib import Path

import bpy

from ..irgspp_addon.jobs import queue as jobs
from ..irgspp_addon.jobs.job import Job
from .images import image
from .phases import phase_in_words
from .run_state import run_state
from .sidebar import button, say, seconds_in_words

BEGAN = time.time()  # this session of Blender
ICONS = {"queued": "TIME", "running": "PLAY", "done": "CHECKMARK", "failed": "ERROR", "cancelled": "X", "lost": "QUESTION"}
WORDS = {
    "queued": "Waits for its turn",
    "running": "Running",
    "done": "Done",
    "failed": "Failed",
    "cancelled": "Cancelled",
    "lost": "Ended while nobody looked",
}
RECONSTRUCTIONS = ("reconstruct", "demo")  # kinds of jobs that make a run
LOG_LINES = 4  # of the log's end where a job failed


def draw_last(layout: bpy.types.UILayout, context: bpy.types.Context, kind: str, run: Path | None) -> None:
    """The job of a kind that works on a run, or the last one of this session, below the button that starts it."""
    jobs_of_run = (job for job in jobs.all_jobs() if job.kind == kind and job.data.get("run") == str(run))
    job = next((job for job in jobs_of_run if not job.finished or job.made > BEGAN), None)
    if job is not None:
        box = layout.box()
        say(box, context, job.title)
        draw_job(box, context, job)


def draw_job(layout: bpy.types.UILayout, context: bpy.types.Context, job: Job) -> None:
    """Progress and what stops the job while it runs; how it ended and what to do next afterwards."""
    column = layout.column()
    if job.finished:
        _draw_end(column, context, job)
    else:
        _draw_progress(column, context, job)
        _draw_stops(column, job)


def _draw_progress(layout: bpy.types.UILayout, context: bpy.types.Context, job: Job) -> None:
    if job.state == "queued":
        layout.label(text=WORDS["queued"], icon=ICONS["queued"])
        return
    say(layout, context, phase_in_words(job.kind, job.phase))
    layout.progress(factor=job.fraction, text=progress_text(job))
    if text := figures_text(job):
        layout.label(text=text)
    if job.preview is not None:
        image(layout, job.preview)
    if job.message:
        say(layout, context, job.message, icon="INFO")


def _draw_stops(layout: bpy.types.UILayout, job: Job) -> None:
    row = layout.row(align=True)
    if job.can_finish_early:
        button(row, "irgspp.job_finish", "Finish Early", "FF", job=job.id)
    button(row, "irgspp.job_cancel", "End Now" if job.stopping else "Cancel", "X", job=job.id)


def _draw_end(layout: bpy.types.UILayout, context: bpy.types.Context, job: Job) -> None:
    took = job.seconds()
    layout.label(text=WORDS[job.state] + (f" after {seconds_in_words(took)}" if took else ""), icon=ICONS[job.state])
    if job.error:
        column = layout.column()
        column.alert = job.state != "cancelled"
        say(column, context, job.error)
    if text := figures_text(job):
        layout.label(text=text)
    row = layout.row(align=True)
    if can_go_on(job):
        button(row, "irgspp.job_resume", "Go On", "FILE_REFRESH", job=job.id)
    button(row, "irgspp.job_log", "Open Log", "TEXT", job=job.id)


def can_go_on(job: Job) -> bool:
    """True where a stopped job has left a run to go on with; one that was refused for its settings has not."""
    return job.resumable and run_state(job.folder).status not in ("", "done")


def progress_text(job: Job) -> str:
    """What stands on the bar: "46 %, 1:20 min left"; the time is that of the present step."""
    left = f", {seconds_in_words(job.eta)} left" if job.eta is not None else ""
    return f"{100 * job.fraction:.0f} %{left}" if job.of else "Working"


def figures_text(job: Job) -> str:
    """Loss and PSNR, where there are any."""
    parts = [f"Loss {job.figures['loss']:.4f}"] if "loss" in job.figures else []
    parts += [f"PSNR {job.figures['psnr']:.1f} dB"] if "psnr" in job.figures else []
    return "   ".join(parts)
