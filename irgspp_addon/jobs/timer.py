# SPDX-License-Identifier: GPL-3.0-or-later
"""Timer that updates the jobs, and handler for newly loaded files."""

from __future__ import annotations

import bpy

from ..windows import redraw_panels, redraw_status_bar
from . import engine_check, queue, result_import, session

BUSY_SECONDS, IDLE_SECONDS = 0.25, 1.0
SHOWING = ("VIEW_3D", "PREFERENCES", "PROPERTIES", "IMAGE_EDITOR")  # areas that may show jobs


def register() -> None:
    """Load the jobs of earlier sessions and start the timer, which runs only with a window: scripts wait for their jobs themselves."""
    queue.ON_DONE.update(result_import.ON_DONE)
    queue.ON_END.update(engine_check.ON_END)
    queue.refresh()
    bpy.app.handlers.load_post.append(_loaded)
    bpy.app.handlers.save_post.append(_saved)
    if not bpy.app.background:
        bpy.app.timers.register(_tick, first_interval=BUSY_SECONDS, persistent=True)


def unregister() -> None:
    """Remove timer and handler and end the session; a timer that stays registered makes Blender hang or crash when it ends."""
    if bpy.app.timers.is_registered(_tick):
        bpy.app.timers.unregister(_tick)
    bpy.app.handlers.load_post.remove(_loaded)
    bpy.app.handlers.save_post.remove(_saved)
    queue.clear()
    session.end_session()


def _tick() -> float:
    if queue.poll():
        redraw_panels(*SHOWING)
        redraw_status_bar()
    return BUSY_SECONDS if queue.unfinished() else IDLE_SECONDS


@bpy.app.handlers.persistent
def _loaded(*_) -> None:
    """Note that another file is open, which must not receive results of jobs started for the previous one."""
    result_import.another_file()
    queue.refresh()


@bpy.app.handlers.persistent
def _saved(*_) -> None:
    """Note in the jobs of this file where it was saved."""
    result_import.saved(queue.all_jobs(), bpy.data.filepath)
