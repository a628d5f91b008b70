# SPDX-License-Identifier: GPL-3.0-or-later
"""Card of one job: its phase, progress and metrics, and the buttons that stop or resume it."""

from __future__ import annotations

import time
from pathlib import Path

import bpy

from ..irgspp_addon.jobs import queue as jobs
from ..irgspp_addon.jobs.job import Job
from ..irgspp_addon.translations import translated
from .capture_state import capture_of
from .images import image
from .phases import phase_in_words, total_fraction
from .run_state import resolved, run_state
from .sidebar import button, say, seconds_in_words

BEGAN = time.time()  # start of this Blender session
ICONS = {"queued": "TIME", "running": "PLAY", "done": "CHECKMARK", "failed": "ERROR", "cancelled": "X", "lost": "QUESTION"}
WORDS = {
    "queued": "Waiting in the queue",
    "running": "Running",
    "done": "Done",
    "failed": "Failed",
    "cancelled": "Cancelled",
    "lost": "Ended unobserved",
}
ENOUGH = 0.05  # fraction of a job that must have been observed before its whole time is estimated
RECONSTRUCTIONS = ("reconstruct", "demo")  # kinds of jobs that make a run

_starts: dict[tuple, tuple[float, float]] = {}  # by job and start: time and fraction of the job when it was seen first


def current_job(run: Path | None) -> Job | None:
    """Return the unfinished reconstruction, else the last one of this run folder; without a folder, the last demo of this session."""
    reconstructions = [job for job in jobs.all_jobs() if job.kind in RECONSTRUCTIONS]
    unfinished = [job for job in reconstructions if not job.finished]
    if run is None:
        last = [job for job in reconstructions if job.kind == "demo" and job.made > BEGAN]
    else:
        last = [job for job in reconstructions if resolved(job.folder) == resolved(run)]
    return next(iter([*reversed(unfinished), *last]), None)


def draw_last(layout: bpy.types.UILayout, context: bpy.types.Context, kind: str, run: Path | None) -> None:
    """Draw the running job of a kind on a run, or its last one in this session, below the button that starts it.

    Args:
        layout: to draw into.
        context: of the panel.
        kind: of the job, such as "bake".
        run: run folder.
    """
    jobs_of_run = (job for job in jobs.all_jobs() if job.kind == kind and job.data.get("run") == str(run))
    job = next((job for job in jobs_of_run if not job.finished or job.made > BEGAN), None)
    if job is not None:
        box = layout.box()
        say(box, context, job.title)
        draw_job(box, context, job)


def draw_job(layout: bpy.types.UILayout, context: bpy.types.Context, job: Job, resume: bool = True) -> None:
    """Draw the progress of a job and its stop buttons while it runs, its outcome and what can follow afterwards.

    Args:
        layout: to draw into.
        context: of the panel.
        job: in the queue or ended.
        resume: True to offer that a stopped job is resumed.
    """
    column = layout.column()
    if job.finished:
        _draw_end(column, context, job, resume)
    else:
        _draw_progress(column, context, job)
        _draw_stops(column, job)  # above what comes and goes, which would move them, often out of sight
        if job.state != "queued":
            _draw_findings(column, context, job)


def _draw_progress(layout: bpy.types.UILayout, context: bpy.types.Context, job: Job) -> None:
    if job.state == "queued":
        layout.label(text=WORDS["queued"], icon=ICONS["queued"])
        return
    say(layout, context, phase_in_words(job.kind, job.phase))
    layout.progress(factor=job.fraction, text=progress_text(job))
    if text := total_text(job, time.time()):
        layout.label(text=text)


def _draw_findings(layout: bpy.types.UILayout, context: bpy.types.Context, job: Job) -> None:
    if job.message:
        say(layout, context, job.message, icon="INFO")
    if text := metrics_text(job):
        layout.label(text=text)
    if job.preview is not None:
        image(layout, job.preview)


def _draw_stops(layout: bpy.types.UILayout, job: Job) -> None:
    row = layout.row(align=True)
    if job.can_finish_early:
        button(row, "irgspp.job_finish", "Finish Early", "FF", job=job.id)
    button(row, "irgspp.job_cancel", "End Now" if job.stopping else "Cancel", "X", job=job.id)


def _draw_end(layout: bpy.types.UILayout, context: bpy.types.Context, job: Job, resume: bool) -> None:
    took = job.seconds()
    word = "Stopped" if job.state == "cancelled" and job.error else WORDS[job.state]  # by the user, or with Blender
    text = translated("{state} after {time}", state=translated(word), time=seconds_in_words(took)) if took else word
    layout.label(text=text, icon=ICONS[job.state])
    if job.error:
        column = layout.column()
        column.alert = job.state != "cancelled"
        say(column, context, job.error)
    if text := metrics_text(job):
        layout.label(text=text)
    row = layout.row(align=True)
    if resume and can_resume(job):
        button(row, "irgspp.job_resume", "Resume", "FILE_REFRESH", job=job.id)
    button(row, "irgspp.job_log", "Open Log", "TEXT", job=job.id)


def can_resume(job: Job) -> bool:
    """Return True where a stopped job left a run or capture that can be resumed; one whose settings were refused left none."""
    if job.kind == "capture":
        return job.resumable and capture_of(job.folder) is not None
    return job.resumable and run_state(job.folder).status not in ("", "done")


def progress_text(job: Job) -> str:
    """Return the text on the progress bar: "46 %, 1:20 min left"; the time is that of the present step."""
    if 0 < job.of <= job.step:
        return translated("Finishing this step")  # what follows the last iteration takes a while too
    left = translated(", {time} left", time=seconds_in_words(job.eta)) if job.eta is not None else ""
    return f"{100 * job.fraction:.0f} %{left}" if job.of else translated("Working")


def total_text(job: Job, now: float) -> str:
    """Return the time that all steps of a reconstruction still take, such as "About 3 min left in all"; empty where it is unknown.

    Args:
        job: running job.
        now: time in seconds since the epoch.
    """
    done = total_fraction(job.kind, job.phase, job.fraction)
    if done is None:
        return ""
    began, before = _starts.setdefault((job.id, job.began), (now, done))  # it may have been resumed
    gained = done - before
    if gained < ENOUGH:
        return ""
    minutes = (now - began) * (1 - done) / gained / 60
    if minutes < 1.5:
        return translated("About a minute left in all")
    return translated("About {count} min left in all", count=f"{minutes:.0f}")


def metrics_text(job: Job) -> str:
    """Return loss and PSNR in one line; empty where neither is known."""
    parts = [translated("Loss {value}", value=f"{job.metrics['loss']:.4f}")] if "loss" in job.metrics else []
    parts += [translated("PSNR {value} dB", value=f"{job.metrics['psnr']:.1f}")] if "psnr" in job.metrics else []
    return "   ".join(parts)
