# SPDX-License-Identifier: GPL-3.0-or-later
"""How the preferences look: which engine, whether it works, how to get one."""

from __future__ import annotations

import textwrap

import bpy

from . import engine, jobs, managed_engine

LETTERS = 60  # on a line of the preferences, which are not wide
ICONS = {"ok": "CHECKMARK", "unknown": "QUESTION", "missing": "ERROR", "broken": "ERROR", "version": "ERROR"}


def draw_preferences(chosen: bpy.types.AddonPreferences, layout: bpy.types.UILayout) -> None:
    """Top to bottom: the choice, its status, what can be done about it."""
    layout.use_property_split = True
    layout.row().prop(chosen, "engine_kind", expand=True)
    if chosen.engine_kind == "EXISTING":
        layout.prop(chosen, "engine_python")
    elif chosen.engine_kind == "MANAGED":
        _draw_managed(chosen, layout)
    found = engine.status()
    column = layout.column(align=True)
    for number, line in enumerate(textwrap.wrap(found.text, LETTERS)):
        column.label(text=line, icon=ICONS[found.state] if number == 0 else "BLANK1")
    layout.operator("irgspp.check_engine", text="Check", icon="FILE_REFRESH")
    layout.prop(chosen, "keep_running")


def _draw_managed(chosen: bpy.types.AddonPreferences, layout: bpy.types.UILayout) -> None:
    layout.row().prop(chosen, "install_device", expand=True)
    layout.prop(chosen, "wheels_folder")
    if not chosen.wheels_folder:
        layout.prop(chosen, "package_index")
    job = next((job for job in jobs.all_jobs() if job.kind == "install"), None)
    if job is not None and not job.finished:
        row = layout.row()
        row.progress(factor=job.fraction, text=job.message or job.phase or "Waiting", type="BAR")
        row.operator("irgspp.job_cancel", text="", icon="CANCEL").job = job.id
        return
    if job is not None and job.error:
        row = layout.row()
        row.alert = True
        row.label(text=job.error, icon="ERROR")
        row.operator("irgspp.job_log", text="Open Log").job = job.id
    row = layout.row()
    installed = managed_engine.python().exists()
    row.operator("irgspp.install_engine", text="Install Again" if installed else "Install Engine", icon="IMPORT")
    row.operator("irgspp.open_engine_folder", icon="FILE_FOLDER")
    row.operator("irgspp.remove_engine", icon="TRASH")
