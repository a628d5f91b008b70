# SPDX-License-Identifier: GPL-3.0-or-later
"""Operator that looks through the camera of a photograph at the photograph's resolution, so that scene and photograph align."""

# pyright: reportInvalidTypeForm=false

import bpy
from bpy.props import StringProperty

from ..core.errors import InputError, IrgsppError
from ..irgspp_addon.importer.cameras import look_through
from .blocking import refuse


class IRGSPP_OT_look_through(bpy.types.Operator):
    """Make this the scene camera, set the render resolution to its photograph's, and look through it: scene and photograph align."""

    bl_idname = "irgspp.look_through"
    bl_label = "Look Through Camera"
    bl_options = {"REGISTER", "UNDO"}  # noqa: RUF012 (Blender wants a plain set)

    camera: StringProperty(name="Camera", description="Name of an imported camera. Empty: the active object", options={"SKIP_SAVE"})

    def execute(self, context: bpy.types.Context) -> set[str]:
        """Look through the camera."""
        try:
            look_through(context.scene, self._camera(context))
        except IrgsppError as error:
            return refuse(self, error)
        space = context.space_data
        if space is not None and space.type == "VIEW_3D":
            space.region_3d.view_perspective = "CAMERA"
        return {"FINISHED"}

    def _camera(self, context: bpy.types.Context) -> bpy.types.Object:
        placed = context.scene.objects.get(self.camera) if self.camera else context.object
        if placed is None or not is_imported(placed):
            raise InputError(self.camera or "look_through", "is not a camera of an imported dataset or run", "select one, or give camera=")
        return placed


def is_imported(thing: bpy.types.Object | None) -> bool:
    """Return True for a camera that an import has made: it stores the size of its photograph."""
    return thing is not None and thing.type == "CAMERA" and "width" in thing.data
