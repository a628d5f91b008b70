# SPDX-License-Identifier: GPL-3.0-or-later
"""Base of the operators that import a folder: the folder, and its placement in Blender's world."""

# pyright: reportInvalidTypeForm=false

from collections.abc import Callable
from typing import TYPE_CHECKING

import bpy
from bpy.props import BoolProperty, EnumProperty, FloatProperty

from ..irgspp_addon import shared_properties as shared
from ..irgspp_addon.importer.placement import Placement


class PlacedImport:
    """Base of importers with a keyword `directory`: asks for the folder where none is given, and places what it imports."""

    bl_options = {"REGISTER", "UNDO", "PRESET"}  # noqa: RUF012 (Blender wants a plain set)

    if TYPE_CHECKING:
        directory: str
        execute: Callable[[bpy.types.Context], set[str]]

    filter_folder: BoolProperty(default=True, options={"HIDDEN"})
    up_axis: EnumProperty(**shared.UP_AXIS)
    scale: FloatProperty(name="Scale", description="Size in Blender, relative to the dataset's own units", default=1.0, min=1e-6, max=1e6)
    recentre: BoolProperty(**shared.RECENTRE)

    def invoke(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        """Ask for the folder where none is given.

        Args:
            context: of the button or menu.
            event: ignored.
        """
        if self.directory:
            return self.execute(context)
        context.window_manager.fileselect_add(self)
        return {"RUNNING_MODAL"}

    def placement(self) -> Placement:
        """Return the placement that the options say."""
        return Placement(self.up_axis, self.scale, self.recentre)
