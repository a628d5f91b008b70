# SPDX-License-Identifier: GPL-3.0-or-later
"""The one timer that looks after the jobs, and what happens when a file is loaded."""

from __future__ import annotations

import bpy

from ..windows import redraw
from . import engine_check as engine_check
from . import queue as jobs
from . import result_import, session

BUSY_SECONDS, IDLE_SECONDS = 0.25, 1.0
SHOWING = ("VIEW_3D", "PREFERENCES", "PROPERTIES", "IMAGE_EDITOR")  # areas that may show jobs


def register() -> None:
    """Find the jobs of earlier sessions and look after them. Without a window nobody waits for them, so there is no timer."""
    jobs.ON_DONE.update(result_import.ON_DONE)
    jobs.ON_END.update(engine_check.ON_END)
    jobs.refresh()
    bpy.app.handlers.load_post.append(_loaded)
    if not bpy.app.background:
        bpy.app.timers.register(_tick, first_interval=BUSY_SECONDS, persistent=True)


def unregister() -> None:
    """A timer that is left registered makes Blender hang or crash at its end."""
    if bpy.app.timers.is_registered(_tick):
        bpy.app.timers.unregister(_tick)
    bpy.app.handlers.load_post.remove(_loaded)
    jobs.clear()
    session.end_session()


def _tick() -> float:
    if jobs.poll():
        redraw(*SHOWING)
    return BUSY_SECONDS if jobs.unfinished() else IDLE_SECONDS


@bpy.app.handlers.persistent
def _loaded(*_) -> None:
    """Another file is open now: it gets no results of jobs that were started for the last one."""
    result_import.another_file()
    jobs.refresh()
