# SPDX-License-Identifier: GPL-3.0-or-later
"""Operator that adds or removes the plane that catches the object's shadow."""

# pyright: reportInvalidTypeForm=false

import bpy
from bpy.props import BoolProperty, StringProperty

from ..core.errors import InputError
from ..irgspp_addon.importer.run_frame import run_object
from ..irgspp_addon.relight.ground import add_plane, added_plane, remove_plane
from .blocking import RUN, refusing
from .result import named_run


class IRGSPP_OT_shadow_catcher(bpy.types.Operator):
    """Add an invisible level plane under the object's foot that catches its shadow, in IRGS++ and in Cycles."""

    bl_idname = "irgspp.shadow_catcher"
    bl_label = "Add Shadow-Catcher Plane"
    bl_options = {"REGISTER", "UNDO"}  # noqa: RUF012 (Blender wants a plain set)

    run: StringProperty(**RUN)
    remove: BoolProperty(name="Remove", description="Remove the plane", default=False, options={"SKIP_SAVE"})

    @refusing()
    def execute(self, context: bpy.types.Context) -> set[str]:
        """Add the plane, or move it under the object again, or remove it."""
        if self.remove:
            if added_plane(context.scene) is None:
                raise InputError("shadow_catcher", "the scene has no such plane")
            remove_plane(context.scene)
            return {"FINISHED"}
        run = named_run(context, self.run)
        thing = run_object(context.scene, run)
        if thing is None or not thing.data.vertices:
            raise InputError(run.name, "its object is not in this scene", "import the run")
        remove_plane(context.scene)
        add_plane(context.scene, thing)
        return {"FINISHED"}


CLASSES = (IRGSPP_OT_shadow_catcher,)
