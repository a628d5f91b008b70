# SPDX-License-Identifier: GPL-3.0-or-later
"""File > Import > IRGS++ Run."""

# pyright: reportInvalidTypeForm=false

from pathlib import Path

import bpy
from bpy.props import BoolProperty, EnumProperty, StringProperty

from ..core.errors import IrgsppError
from ..irgspp_addon.scene_builder import import_run, show_as_photographed


class IRGSPP_OT_import_run(bpy.types.Operator):
    """Import the object, materials, light and cameras of a finished reconstruction"""

    bl_idname = "irgspp.import_run"
    bl_label = "Import IRGS++ Run"
    bl_options = {"REGISTER", "UNDO"}  # noqa: RUF012 (Blender wants a plain set)

    directory: StringProperty(name="Run Folder", subtype="DIR_PATH", options={"SKIP_SAVE"})
    filter_folder: BoolProperty(default=True, options={"HIDDEN"})
    material: EnumProperty(
        name="Material Reads",
        items=[("textures", "Textures", "Pictures through the UV map", 0), ("attributes", "Attributes", "Values at the vertices", 1)],
    )
    pack: BoolProperty(name="Pack Textures", description="Put textures and light into the .blend", default=True)
    as_photographed: BoolProperty(
        name="Show as Photographed",
        description="Light the scene by the recovered light and look through the first camera, without tone mapping",
        default=False,
    )

    def invoke(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        context.window_manager.fileselect_add(self)
        return {"RUNNING_MODAL"}

    def execute(self, context: bpy.types.Context) -> set[str]:
        try:
            imported = import_run(Path(bpy.path.abspath(self.directory)), self.material, self.pack)
        except IrgsppError as error:
            self.report({"ERROR"}, str(error))
            return {"CANCELLED"}
        for thing in context.selected_objects:
            thing.select_set(False)
        imported.mesh.select_set(True)
        context.view_layer.objects.active = imported.mesh
        if self.as_photographed:
            show_as_photographed(context.scene, imported)
        return {"FINISHED"}


def draw_import(self: bpy.types.Menu, context: bpy.types.Context) -> None:
    """The entry in File > Import."""
    self.layout.operator(IRGSPP_OT_import_run.bl_idname, text="IRGS++ Run (folder)")
