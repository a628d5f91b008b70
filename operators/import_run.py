# SPDX-License-Identifier: GPL-3.0-or-later
"""Operator that imports a finished run (File > Import > IRGS++ Run)."""

# pyright: reportInvalidTypeForm=false

from pathlib import Path

import bpy
from bpy.props import BoolProperty, EnumProperty, StringProperty

from ..core.errors import InputError
from ..irgspp_addon import shared_properties as shared
from ..irgspp_addon.importer.arrangement import arrange
from ..irgspp_addon.importer.moved_project import IDENTITY, adopt_moved_run, run_identity
from ..irgspp_addon.importer.run_frame import run_object
from ..irgspp_addon.importer.scene_builder import import_run, show_as_photographed
from ..irgspp_addon.windows import show_selected
from .blocking import refusing
from .placed_import import PlacedImport


class IRGSPP_OT_import_run(PlacedImport, bpy.types.Operator):
    """Import the object, material, light and cameras of a finished reconstruction; they replace its last import."""

    bl_idname = "irgspp.import_run"
    bl_label = "Import IRGS++ Run"
    directory: StringProperty(name="Run Folder", subtype="DIR_PATH", options={"SKIP_SAVE", "SKIP_PRESET"})
    material: EnumProperty(**shared.SOURCE)
    pack: BoolProperty(
        name="Pack Textures", description="Keep textures and light inside the .blend instead of linking to the run folder", default=True
    )
    as_photographed: BoolProperty(
        name="As Photographed",
        description="Light the scene with the recovered light and look through the first camera, without tone mapping",
        default=False,
    )
    arrange: BoolProperty(
        name="Arrange View",
        description="At the first import: frame the object in Material Preview, hide the cameras and the untouched default cube and light, "
        "and replace the untouched default World by the recovered light",
        default=False,
        options={"SKIP_SAVE"},
    )

    def invoke(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        """Import as a button does, which also arranges the view.

        Args:
            context: of the button or menu.
            event: ignored.
        """
        if not self.properties.is_property_set("arrange"):
            self.arrange = True
        return super().invoke(context, event)

    @refusing()
    def execute(self, context: bpy.types.Context) -> set[str]:
        """Import the run."""
        if not self.directory:
            raise InputError("run", "none is chosen", "choose the folder of a finished run")
        chosen = any(self.properties.is_property_set(name) for name in ("up_axis", "scale", "recentre"))
        placement = self.placement() if chosen else None
        run = Path(bpy.path.abspath(self.directory))
        adopt_moved_run(run)
        is_new = run_object(context.scene, run) is None
        imported = import_run(run, self.material, self.pack, placement, context.scene)
        imported.root[IDENTITY] = run_identity(run)
        select(context, imported.mesh)
        if self.arrange and is_new:
            arrange(context.scene, context.view_layer, imported.world)
            show_selected(context.scene)
        if self.as_photographed:
            show_as_photographed(context.scene, imported)
        return {"FINISHED"}


def select(context: bpy.types.Context, thing: bpy.types.Object) -> None:
    """Select an object alone and make it active, where it is in the view layer.

    Args:
        context: with the view layer.
        thing: object.
    """
    context.view_layer.update()  # from Blender 5.0 on, it knows newly linked objects only after this
    visible = context.view_layer.objects
    for other in [other for other in visible if other.select_get(view_layer=context.view_layer)]:
        other.select_set(False, view_layer=context.view_layer)
    if thing.name in visible:
        thing.select_set(True, view_layer=context.view_layer)
        visible.active = thing


def draw_import(self: bpy.types.Menu, context: bpy.types.Context) -> None:
    """Add the entry to the menu File > Import.

    Args:
        self: menu.
        context: of the menu.
    """
    self.layout.operator(IRGSPP_OT_import_run.bl_idname, text="IRGS++ Run (folder)")
