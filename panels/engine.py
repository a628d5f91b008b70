# SPDX-License-Identifier: GPL-3.0-or-later
"""Panel of the engine, shown first while no engine works: what is missing and how to set it up."""

from __future__ import annotations

import bpy

from ..irgspp_addon.engine import process as engine
from ..irgspp_addon.jobs.engine_check import with_installation
from ..irgspp_addon.user_folder import EXTENSION
from .sidebar import SidebarPanel, button, say


class IRGSPP_PT_engine(SidebarPanel, bpy.types.Panel):
    """Panel that is shown until an engine works."""

    bl_label = "Engine"
    bl_order = 1

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """Return True while no engine works."""
        return engine.status().state != "ok"

    def draw(self, context: bpy.types.Context) -> None:
        """Draw the problem and the buttons that set up and check the engine."""
        status, layout = with_installation(engine.status()), self.layout
        if status.state in ("unknown", "installing"):
            say(layout, context, status.text or "The engine has not been checked yet.", icon="TIME")
        else:
            column = layout.column()
            column.alert = True
            say(column, context, status.text, icon="ERROR")
            say(layout, context, "The engine runs in a Python environment of its own. Set it up once in the preferences.")
        column = layout.column(align=True)
        column.scale_y = 1.3
        button(column, "preferences.addon_show", "Set Up Engine", "PREFERENCES", module=EXTENSION)
        button(layout, "irgspp.check_engine", "Check Engine", "FILE_REFRESH")


CLASSES = (IRGSPP_PT_engine,)
