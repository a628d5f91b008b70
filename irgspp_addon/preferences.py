# SPDX-License-Identifier: GPL-3.0-or-later
"""What belongs to this machine rather than to a scene."""

# pyright: reportInvalidTypeForm=false

import bpy
from bpy.props import StringProperty

EXTENSION = (__package__ or "").removesuffix(".irgspp_addon")


class IRGSPP_Preferences(bpy.types.AddonPreferences):
    """Where the engine runs."""

    bl_idname = EXTENSION

    engine_python: StringProperty(
        name="Engine Python",
        description="Python executable with the engine's libraries (torch and others). Empty: Blender's own Python",
        subtype="FILE_PATH",
    )

    def draw(self, context: bpy.types.Context) -> None:
        self.layout.prop(self, "engine_python")
