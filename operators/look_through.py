# SPDX-License-Identifier: GPL-3.0-or-later
"""Operators of cameras of photographs: look through them, show or hide them, and compare the object under comparable colours."""

# pyright: reportInvalidTypeForm=false

import bpy
from bpy.props import BoolProperty, IntProperty, StringProperty

from ..core.errors import InputError
from ..irgspp_addon.comparison import view_colours
from ..irgspp_addon.comparison.photograph import fade, opacity
from ..irgspp_addon.importer.arrangement import cameras_in, is_imported_camera, show_alone, show_cameras
from ..irgspp_addon.importer.cameras import look_through
from ..irgspp_addon.importer.run_root import run_of
from ..irgspp_addon.translations import translated
from .blocking import refusing


class IRGSPP_OT_look_through(bpy.types.Operator):
    """Make this the scene camera, set the render resolution to its photograph's, and look through it: scene and photograph align."""

    bl_idname = "irgspp.look_through"
    bl_label = "Look Through Camera"
    bl_options = {"REGISTER", "UNDO"}  # noqa: RUF012 (Blender wants a plain set)

    camera: StringProperty(name="Camera", description="Name of an imported camera. Empty: the active object", options={"SKIP_SAVE"})

    @refusing()
    def execute(self, context: bpy.types.Context) -> set[str]:
        """Look through the camera."""
        _look(context, self._camera(context))
        return {"FINISHED"}

    def _camera(self, context: bpy.types.Context) -> bpy.types.Object:
        placed = context.scene.objects.get(self.camera) if self.camera else context.object
        if placed is None or not is_imported_camera(placed):
            raise InputError(self.camera or "look_through", "is not a camera of an imported dataset or run", "select one, or give camera=")
        return placed


class IRGSPP_OT_step_photograph(bpy.types.Operator):
    """Look through the camera of the next or previous photograph."""

    bl_idname = "irgspp.step_photograph"
    bl_label = "Next Photograph"
    bl_options = {"REGISTER", "UNDO"}  # noqa: RUF012 (Blender wants a plain set)

    step: IntProperty(name="Step", description="Photographs to go on by; negative: back", default=1, options={"SKIP_SAVE"})

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """Return True where the scene has imported cameras."""
        cls.poll_message_set(translated("The scene has no imported cameras"))
        return any(is_imported_camera(thing) for thing in context.scene.objects)

    def execute(self, context: bpy.types.Context) -> set[str]:
        """Look through the camera."""
        cameras = cameras_to_step(context)
        present = cameras.index(context.scene.camera) if context.scene.camera in cameras else (-1 if self.step > 0 else 0)
        _look(context, cameras[(present + self.step) % len(cameras)])
        return {"FINISHED"}


class IRGSPP_OT_show_cameras(bpy.types.Operator):
    """Show or hide the imported cameras and the sphere around the object in the 3D View."""

    bl_idname = "irgspp.show_cameras"
    bl_label = "Show Cameras"
    bl_options = {"REGISTER", "UNDO"}  # noqa: RUF012 (Blender wants a plain set)

    show: BoolProperty(name="Show", description="Show the cameras; otherwise hide them", default=True, options={"SKIP_SAVE"})

    def execute(self, context: bpy.types.Context) -> set[str]:
        """Show or hide the cameras."""
        show_cameras(context.scene, self.show)
        return {"FINISHED"}


class IRGSPP_OT_comparison_colours(bpy.types.Operator):
    """Show the result under the view transform Standard, in whose colours it can be compared with a photograph."""

    bl_idname = "irgspp.comparison_colours"
    bl_label = "Compare under Standard"
    bl_options = {"REGISTER", "UNDO"}  # noqa: RUF012 (Blender wants a plain set)

    restore: BoolProperty(
        name="Restore",
        description="Choose view settings and light from before the comparison again",
        default=False,
        options={"SKIP_SAVE"},
    )

    def execute(self, context: bpy.types.Context) -> set[str]:
        """Choose the view settings."""
        if self.restore:
            view_colours.restore(context.scene)
        else:
            view_colours.make_plain(context.scene)
        return {"FINISHED"}


def cameras_to_step(context: bpy.types.Context) -> list[bpy.types.Object]:
    """Return the cameras that the steps go through: those of the present camera's or the active object's run, else all."""
    cameras = cameras_in(context.scene)
    present = context.scene.camera if is_imported_camera(context.scene.camera) else context.object
    run = run_of(present)
    return [camera for camera in cameras if run_of(camera) == run] or cameras


def _look(context: bpy.types.Context, camera: bpy.types.Object) -> None:
    """Look through a camera, also in the 3D View that the button is in; its photograph fades over the object as the one before did."""
    faded = opacity(context.scene)
    show_alone(context.scene, camera)
    look_through(context.scene, camera)
    fade(context.scene, faded)
    space = context.space_data
    if space is not None and space.type == "VIEW_3D":
        space.region_3d.view_perspective = "CAMERA"


CLASSES = (IRGSPP_OT_look_through, IRGSPP_OT_step_photograph, IRGSPP_OT_show_cameras, IRGSPP_OT_comparison_colours)
