# SPDX-License-Identifier: GPL-3.0-or-later
"""Timer that shows what running reconstructions have found so far, in the scenes from which they were started."""

from __future__ import annotations

from typing import Any

import bpy
from bpy.app.handlers import persistent  # pyright: ignore[reportMissingImports]

from ..irgspp_addon.importer.arrangement import end_hiding, hide_default_objects
from ..irgspp_addon.importer.live_shape import SHAPE, remove_live_shape, show_live_shape
from ..irgspp_addon.importer.ownership import Owner
from ..irgspp_addon.jobs import queue as jobs
from ..irgspp_addon.jobs import result_import
from ..irgspp_addon.jobs.job import Job
from ..irgspp_addon.windows import redraw, show_selected
from .import_run import select

SECONDS = 1.0  # between two looks at the jobs' folders
NOTHING = -1  # time stamp of no file
KINDS = ("reconstruct", "demo")

_shown: dict[str, int] = {}  # by job: time stamp of the file that is shown, nanoseconds
_ended: set[str] = set()  # jobs whose shapes were removed


def follow(job: Job) -> None:
    """Show the present shape of a running job; when the job has ended, remove it, and show the hidden cube and light if no result came.

    Args:
        job: of any kind and state.
    """
    place = job.data.get("place")
    if job.kind not in KINDS or job.folder is None or not place or not result_import.is_open(place):
        return
    if job.finished:
        if job.id not in _ended:
            remove_live_shape(job.folder)
            end_hiding(job.folder, show=Owner(job.folder).find(bpy.data.objects, "mesh") is None)
            _ended.add(job.id)
            _shown.pop(job.id, None)
        return
    _ended.discard(job.id)
    scene = bpy.data.scenes.get(place["scene"])
    if job.state == "running" and scene is not None and scene.irgspp.live_shape:
        _show(job, scene)


def _show(job: Job, scene: bpy.types.Scene) -> None:
    """Show the job's shape if it is newer than the one that is shown, and than the job."""
    try:
        written = (job.folder / SHAPE).stat().st_mtime_ns
    except OSError:  # there is none yet
        return
    if written == _shown.get(job.id) or written < 1e9 * (job.began or 0.0):
        return
    first, _shown[job.id] = job.id not in _shown, written
    shape = show_live_shape(job.folder, scene)
    if shape is not None and first and bpy.context.scene == scene and hide_default_objects(scene, bpy.context.view_layer, job.folder):
        select(bpy.context, shape)  # in a new file; elsewhere the user is at work, and the view stays
        show_selected(scene, materials=False)
        shape.select_set(False)  # the colour of the selection would hide the points' own
    redraw("VIEW_3D")


@persistent
def _undone(*_: Any) -> None:
    """Look at all jobs anew: the step that was restored may lack the shape, or have that of a job which has ended since."""
    _ended.clear()
    for job in _shown:
        _shown[job] = NOTHING


def _tick() -> float:
    if not bpy.app.is_job_running("RENDER"):  # Blender may crash when objects change while it renders
        for job in jobs.all_jobs():
            follow(job)
    return SECONDS


def register() -> None:
    """Start the timer, which runs only with a window, and follow undo and redo."""
    for handlers in (bpy.app.handlers.undo_post, bpy.app.handlers.redo_post):
        handlers.append(_undone)
    if not bpy.app.background:
        bpy.app.timers.register(_tick, first_interval=SECONDS, persistent=True)


def unregister() -> None:
    """Stop the timer and forget the jobs."""
    for handlers in (bpy.app.handlers.undo_post, bpy.app.handlers.redo_post):
        handlers.remove(_undone)
    if bpy.app.timers.is_registered(_tick):
        bpy.app.timers.unregister(_tick)
    _shown.clear()
    _ended.clear()
