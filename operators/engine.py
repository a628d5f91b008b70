# SPDX-License-Identifier: GPL-3.0-or-later
"""Operators that check, install, open and remove the engine."""

# pyright: reportInvalidTypeForm=false

from pathlib import Path

import bpy
from bpy.props import BoolProperty, EnumProperty, StringProperty

from ..irgspp_addon.engine import managed as managed_engine
from ..irgspp_addon.engine import process as engine
from ..irgspp_addon.engine.preferences import preferences
from ..irgspp_addon.jobs import engine_check as engine_check
from ..irgspp_addon.jobs import queue as jobs
from ..irgspp_addon.preferences_page import DEVICES
from ..irgspp_addon.translations import translated
from .blocking import SKIP, WAIT, Queued, StartedByButton, refuse, refusing, run_to_end


class IRGSPP_OT_check_engine(StartedByButton, bpy.types.Operator):
    """Start the engine and show its version and the devices it can compute on."""

    bl_idname = "irgspp.check_engine"
    bl_label = "Check Engine"

    @refusing()
    def start(self, context: bpy.types.Context) -> set[str]:
        """Check the engine in the background, so that the window stays responsive."""
        job = engine_check.check_in_background()
        self.report({"INFO"} if job else {"WARNING"}, translated("Checking the engine") if job else engine.status().text)
        return {"FINISHED"}

    def execute(self, context: bpy.types.Context) -> set[str]:
        """Check the engine and report the result."""
        found = engine.check()
        if found.state != "ok":
            return refuse(self, found.text)
        self.report({"INFO"}, found.text)
        return {"FINISHED"}


class IRGSPP_OT_install_engine(Queued, bpy.types.Operator):
    """Install the engine's libraries into a folder of this extension: about 1 GB for the CPU, several GB for CUDA."""

    bl_idname = "irgspp.install_engine"
    bl_label = "Install Engine"

    device: EnumProperty(name="For", description="Hardware that the engine will compute on", items=DEVICES, options=SKIP)
    wheels: StringProperty(
        name="Wheels",
        description="Folder of Python wheels to install from without the network. Empty: download them",
        subtype="DIR_PATH",
        options=SKIP,
    )
    wait: BoolProperty(**WAIT)

    @refusing()
    def execute(self, context: bpy.types.Context) -> set[str]:
        """Start the installation as a job."""
        chosen = preferences()
        given = self.properties.is_property_set
        device = self.device if given("device") or chosen is None else chosen.install_device
        folder = self.wheels if given("wheels") or chosen is None else chosen.wheels_folder
        wheels = Path(bpy.path.abspath(folder)) if folder else None
        if engine_check.being_installed():
            return refuse(self, "The engine is already being installed")
        index = chosen.package_index if chosen is not None else ""
        arguments = managed_engine.install_arguments(device, wheels, index, bpy.app.online_access)
        place = managed_engine.folder()
        job = jobs.start("install", translated("Install engine"), place, arguments, program=str(managed_engine.INSTALLER))
        if chosen is not None:
            chosen.engine_kind = "MANAGED"
        return run_to_end(self, job) if self.wait else {"FINISHED"}


class IRGSPP_OT_remove_engine(bpy.types.Operator):
    """Delete the engine that this extension has installed."""

    bl_idname = "irgspp.remove_engine"
    bl_label = "Remove"

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """Return True where this extension has installed an engine and no job needs it."""
        if not managed_engine.is_installed():
            cls.poll_message_set(translated("This extension has not installed an engine"))
            return False
        if jobs.unfinished():
            cls.poll_message_set(translated("Jobs are running or waiting"))
            return False
        return True

    def invoke(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        """Ask for confirmation first.

        Args:
            context: of the button or menu.
            event: ignored.
        """
        return context.window_manager.invoke_confirm(self, event)

    @refusing()
    def execute(self, context: bpy.types.Context) -> set[str]:
        """Delete the engine's folder."""
        managed_engine.remove()
        return {"FINISHED"}


class IRGSPP_OT_open_engine_folder(bpy.types.Operator):
    """Open the folder of the installed engine."""

    bl_idname = "irgspp.open_engine_folder"
    bl_label = "Open Folder"

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """Return True where this extension has installed an engine."""
        cls.poll_message_set(translated("This extension has not installed an engine"))
        return managed_engine.is_installed()

    def execute(self, context: bpy.types.Context) -> set[str]:
        """Open the folder in the file browser of the system."""
        return bpy.ops.wm.path_open(filepath=str(managed_engine.folder()))
