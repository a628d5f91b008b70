# SPDX-License-Identifier: GPL-3.0-or-later
"""The extension's page in Blender's preferences: which engine, whether it works, how to install one."""

# pyright: reportInvalidTypeForm=false

import textwrap

import bpy
from bpy.props import BoolProperty, EnumProperty, StringProperty

from .engine import managed as managed_engine
from .engine import process as engine
from .engine.preferences import DEFAULT_KIND
from .jobs import queue as jobs
from .user_folder import EXTENSION

KINDS = [
    ("EXISTING", "Existing", "A Python environment that has the engine's libraries", 0),
    ("MANAGED", "Managed", "An environment that this extension installs for itself", 1),
    ("INTERPRETER", "Blender's Python", "The Python that Blender itself runs, where the libraries are installed for it", 2),
]
DEVICES = [
    ("cpu", "CPU", "What the processor needs", 0),
    ("cuda", "CUDA", "What an NVIDIA graphics card needs as well; larger by some gigabytes", 1),
]
LETTERS = 60  # on a line of the preferences, which are not wide
ICONS = {"ok": "CHECKMARK", "unknown": "QUESTION", "missing": "ERROR", "broken": "ERROR", "version": "ERROR"}


def _choose_existing(chosen: "IRGSPP_Preferences", context: bpy.types.Context) -> None:
    if chosen.engine_python:
        chosen.engine_kind = "EXISTING"


class IRGSPP_Preferences(bpy.types.AddonPreferences):
    """Where the engine runs."""

    bl_idname = EXTENSION

    engine_kind: EnumProperty(
        name="Engine",
        description="What computes: a Python of its own, as its libraries must not enter Blender",
        items=KINDS,
        default=DEFAULT_KIND,
    )
    engine_python: StringProperty(
        name="Engine Python",
        description="Python executable, or folder of a virtual environment, with the engine's libraries (torch and others)",
        subtype="FILE_PATH",
        update=_choose_existing,
    )
    install_device: EnumProperty(name="For", description="What the engine shall compute on", items=DEVICES)
    wheels_folder: StringProperty(
        name="Wheels",
        description="Folder of Python wheels to install from without the network. Empty: download them",
        subtype="DIR_PATH",
    )
    package_index: StringProperty(
        name="Package Index",
        description="Address of another index that pip looks in as well, such as that of torch for the CPU alone. Empty: pip's own",
    )
    keep_running: BoolProperty(
        name="Jobs Survive Blender",
        description="Let jobs go on when Blender is closed; otherwise they save what they have and stop, and can be resumed",
        default=False,
    )

    def draw(self, context: bpy.types.Context) -> None:
        draw_preferences(self, self.layout)


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
