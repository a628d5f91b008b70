# SPDX-License-Identifier: GPL-3.0-or-later
"""The extension's page in Blender's preferences: choice of the engine, its status, and its installation."""

# pyright: reportInvalidTypeForm=false

import textwrap
from contextlib import suppress

import bpy
from bpy.props import BoolProperty, EnumProperty, StringProperty

from ..core.errors import IrgsppError
from .engine import managed
from .engine.preferences import DEFAULT_KIND
from .engine.process import status
from .jobs.engine_check import check_in_background, with_installation
from .jobs.queue import all_jobs
from .user_folder import EXTENSION

KINDS = [
    ("EXISTING", "Existing", "Use a Python environment that already has the engine's libraries", 0),
    ("MANAGED", "Managed", "Use an environment that this extension installs for itself", 1),
    ("INTERPRETER", "In Blender", "Use the Python that runs Blender, if the libraries are installed there", 2),
]
DEVICES = [
    ("cpu", "CPU", "Install the libraries for the processor", 0),
    ("cuda", "CUDA", "Also install the libraries for an NVIDIA graphics card; several gigabytes more", 1),
]
LETTERS = 60  # characters on a line of the preferences, which are narrow
ICONS = {"ok": "CHECKMARK", "unknown": "QUESTION", "installing": "TIME", "missing": "ERROR", "broken": "ERROR", "version": "ERROR"}


def _choose_existing(preferences: "IRGSPP_Preferences", context: bpy.types.Context) -> None:
    if preferences.engine_python:
        preferences.engine_kind = "EXISTING"  # which checks it


def _check_chosen(preferences: "IRGSPP_Preferences", context: bpy.types.Context) -> None:
    """Check a newly chosen engine at once, without blocking Blender."""
    if not bpy.app.background and status().state == "unknown":
        with suppress(IrgsppError):  # such as a full disk: the button Check Engine tells it
            check_in_background()


class IRGSPP_Preferences(bpy.types.AddonPreferences):
    """Preferences of the extension: the engine's Python, its installation, and jobs that outlive Blender."""

    bl_idname = EXTENSION

    engine_kind: EnumProperty(
        name="Engine",
        description="Python environment that computes, separate from Blender because its libraries can conflict with Blender's",
        items=KINDS,
        default=DEFAULT_KIND,
        update=_check_chosen,
    )
    engine_python: StringProperty(
        name="Engine Python",
        description="Python executable, or folder of a virtual environment, that has the engine's libraries (torch and others)",
        subtype="FILE_PATH",
        update=_choose_existing,
    )
    install_device: EnumProperty(name="For", description="Hardware that the engine computes on", items=DEVICES)
    wheels_folder: StringProperty(
        name="Wheels",
        description="Folder of Python wheels (*.whl) to install from without the network. Empty: download them",
        subtype="DIR_PATH",
    )
    package_index: StringProperty(
        name="Package Index",
        description="Address of an additional package index for pip, such as the one with torch for CPU only. Empty: pip's default index",
    )
    hdri_folder: StringProperty(
        name="HDRI Folder",
        description="Folder of images of surroundings (.hdr, .exr) that the panel Relight offers next to Blender's own",
        subtype="DIR_PATH",
    )
    keep_running: BoolProperty(
        name="Jobs Survive Blender",
        description="Jobs continue when Blender is closed. Otherwise they save their progress and stop, and can be resumed",
        default=False,
    )

    def draw(self, context: bpy.types.Context) -> None:
        """Draw the page."""
        draw_preferences(self, self.layout)


def draw_preferences(preferences: bpy.types.AddonPreferences, layout: bpy.types.UILayout) -> None:
    """Draw the choice of the engine, its status, and the buttons to check or install it.

    Args:
        preferences: the extension's preferences.
        layout: layout to draw into.
    """
    layout.use_property_split = True
    layout.row().prop(preferences, "engine_kind", expand=True)
    if preferences.engine_kind == "EXISTING":
        layout.prop(preferences, "engine_python")
    elif preferences.engine_kind == "MANAGED":
        _draw_managed(preferences, layout)
    engine = with_installation(status("here"))
    column = layout.column(align=True)
    for number, line in enumerate(textwrap.wrap(engine.text, LETTERS)):
        column.label(text=line, icon=ICONS[engine.state] if number == 0 else "BLANK1")
    layout.operator("irgspp.check_engine", text="Check Engine", icon="FILE_REFRESH")
    layout.prop(preferences, "keep_running")
    layout.prop(preferences, "hdri_folder")


def _draw_managed(preferences: bpy.types.AddonPreferences, layout: bpy.types.UILayout) -> None:
    layout.row().prop(preferences, "install_device", expand=True)
    layout.prop(preferences, "wheels_folder")
    if not preferences.wheels_folder:
        layout.prop(preferences, "package_index")
    job = next((job for job in all_jobs() if job.kind == "install"), None)
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
    row.operator("irgspp.install_engine", text="Install Again" if managed.is_installed() else "Install Engine", icon="IMPORT")
    row.operator("irgspp.open_engine_folder", icon="FILE_FOLDER")
    row.operator("irgspp.remove_engine", icon="TRASH")
