# SPDX-License-Identifier: GPL-3.0-or-later
"""Everything that Blender is told of, in order, and taken back in reverse."""

from __future__ import annotations

from typing import Any

import bpy

from .. import panels
from ..operators import engine as engine_operators
from ..operators import import_dataset
from ..operators import jobs as job_operators
from ..operators import relight as relight_operators
from ..operators import result as result_operators
from ..operators.import_run import IRGSPP_OT_import_run, draw_import
from ..operators.look_through import IRGSPP_OT_look_through
from ..operators.reconstruct import IRGSPP_OT_demo, IRGSPP_OT_reconstruct
from . import properties
from .engine.process import run_engine
from .importer import materials
from .jobs import queue as jobs
from .jobs import timer as job_timer
from .preferences_page import IRGSPP_Preferences
from .relight import live_image as relight_follow
from .relight import render_engine
from .relight import session as relight_session

CLASSES = (
    IRGSPP_Preferences,
    *properties.CLASSES,
    engine_operators.IRGSPP_OT_check_engine,
    engine_operators.IRGSPP_OT_install_engine,
    engine_operators.IRGSPP_OT_remove_engine,
    engine_operators.IRGSPP_OT_open_engine_folder,
    IRGSPP_OT_reconstruct,
    IRGSPP_OT_demo,
    job_operators.IRGSPP_OT_job_cancel,
    job_operators.IRGSPP_OT_job_finish,
    job_operators.IRGSPP_OT_job_resume,
    job_operators.IRGSPP_OT_job_forget,
    job_operators.IRGSPP_OT_job_log,
    IRGSPP_OT_import_run,
    IRGSPP_OT_look_through,
    *import_dataset.CLASSES,
    *result_operators.CLASSES,
    *relight_operators.CLASSES,
    render_engine.IRGSPP_RenderEngine,
    *panels.CLASSES,
)

_commands: list[Any] = []  # handles that Blender wants back


def register() -> None:
    """Classes, menu entries and `blender --command irgspp`."""
    for cls in CLASSES:
        bpy.utils.register_class(cls)
    properties.register()
    materials.register()
    jobs.CHANGED.append(properties.show_jobs)
    job_timer.register()
    panels.register()
    bpy.types.TOPBAR_MT_file_import.append(draw_import)
    import_dataset.register()
    result_operators.register()
    relight_session.register()
    relight_follow.register()
    render_engine.register()
    _commands.append(bpy.utils.register_cli_command("irgspp", run_engine))


def unregister() -> None:
    """Leave nothing behind."""
    while _commands:
        bpy.utils.unregister_cli_command(_commands.pop())
    render_engine.unregister()
    relight_follow.unregister()
    relight_session.unregister()
    result_operators.unregister()
    import_dataset.unregister()
    bpy.types.TOPBAR_MT_file_import.remove(draw_import)
    panels.unregister()
    job_timer.unregister()
    jobs.CHANGED.remove(properties.show_jobs)
    materials.unregister()
    properties.unregister()
    for cls in reversed(CLASSES):
        bpy.utils.unregister_class(cls)
