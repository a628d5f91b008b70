# SPDX-License-Identifier: GPL-3.0-or-later
"""Operators that choose the scene's light: an HDRI, or the light that was recovered from the photographs."""

# pyright: reportInvalidTypeForm=false

from pathlib import Path

import bpy
from bpy.props import StringProperty

from ..core.errors import InputError
from ..irgspp_addon.importer.run_root import recovered_light
from ..irgspp_addon.windows import show_world
from ..irgspp_addon.world.light_controls import SUFFIXES, use_hdri
from .blocking import RUN, SKIP, refusing
from .file_dialog import FileDialog
from .result import named_run


class IRGSPP_OT_open_hdri(FileDialog, bpy.types.Operator):
    """Light the scene by an image of the surroundings, as its World. Rotation and strength stay as they are."""

    bl_idname = "irgspp.open_hdri"
    bl_label = "Open HDRI"
    bl_options = {"REGISTER", "UNDO"}  # noqa: RUF012 (Blender wants a plain set)

    filepath: StringProperty(name="File", description="Lat-long image (.hdr or .exr)", subtype="FILE_PATH", options=SKIP)
    filter_glob: StringProperty(default=";".join(f"*{suffix}" for suffix in SUFFIXES), options={"HIDDEN"})

    @refusing(RuntimeError)  # the latter is Blender's, for a file that is no image
    def execute(self, context: bpy.types.Context) -> set[str]:
        """Light the scene."""
        if not self.filepath:
            raise InputError("open_hdri", "no file is named", "give filepath=")
        use_hdri(context.scene, Path(bpy.path.abspath(self.filepath)).absolute())
        context.scene.irgspp.use_world = True
        show_world(context.scene)
        return {"FINISHED"}


class IRGSPP_OT_use_recovered_light(bpy.types.Operator):
    """Light the scene as the object was photographed, by the recovered light as its World."""

    bl_idname = "irgspp.use_recovered_light"
    bl_label = "Recovered Light"
    bl_options = {"REGISTER", "UNDO"}  # noqa: RUF012 (Blender wants a plain set)

    run: StringProperty(**RUN)

    @refusing()
    def execute(self, context: bpy.types.Context) -> set[str]:
        """Light the scene."""
        run = named_run(context, self.run)
        world = recovered_light(run)
        if world is None:
            raise InputError(run.name, "its recovered light is not in this file", "import the run")
        context.scene.world, context.scene.irgspp.use_world = world, True
        show_world(context.scene)
        return {"FINISHED"}


CLASSES = (IRGSPP_OT_open_hdri, IRGSPP_OT_use_recovered_light)
