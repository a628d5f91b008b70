# SPDX-License-Identifier: GPL-3.0-or-later
"""Operators that show images of a captured dataset in the Image Editor: paint a mask, save masks, show the contact sheet."""

# pyright: reportInvalidTypeForm=false

from pathlib import Path

import bpy
from bpy.props import EnumProperty, StringProperty

from ..core.errors import InputError
from ..irgspp_addon.importer.mask_image import open_mask, save_masks
from ..irgspp_addon.translations import translated
from ..irgspp_addon.windows import fit_image, in_area, open_image_editor
from .blocking import SKIP, refuse, refusing

BRUSH = "IRGS++ Mask"


class IRGSPP_OT_edit_mask(bpy.types.Operator):
    """Paint the mask of this camera's photograph in an Image Editor: erase what is not the object, add what is missing."""

    bl_idname = "irgspp.edit_mask"
    bl_label = "Edit Mask"
    bl_options = {"REGISTER"}  # noqa: RUF012 (Blender wants a plain set)

    camera: StringProperty(name="Camera", description="Name of an imported camera. Empty: the active object", options=SKIP)

    @refusing()
    def execute(self, context: bpy.types.Context) -> set[str]:
        """Open the mask; in background mode only its image is made."""
        camera = context.scene.objects.get(self.camera) if self.camera else context.object
        if camera is None:
            raise InputError(self.camera or "edit_mask", "is not a camera of a captured dataset", "select one, or give camera=")
        image = open_mask(camera)
        if not bpy.app.background:
            area = open_image_editor(image)
            area.spaces.active.ui_mode = "PAINT"
            area.spaces.active.show_region_ui = True
            fit_image(area)
        return {"FINISHED"}


class IRGSPP_OT_mask_brush(bpy.types.Operator):
    """Paint on the mask with the brush "IRGS++ Mask"."""

    bl_idname = "irgspp.mask_brush"
    bl_label = "Mask Brush"
    bl_options = {"REGISTER", "INTERNAL"}  # noqa: RUF012 (Blender wants a plain set)

    blend: EnumProperty(
        name="Paint",
        description="What the brush does",
        items=[
            ("ERASE_ALPHA", "Erase", "Erase what is not the object", 0),
            ("ADD_ALPHA", "Add", "Add what is missing of the object", 1),
        ],
        options=SKIP,
    )

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """Return True in an Image Editor that is ready for painting; Blender crashes where a brush is chosen before."""
        area = context.area
        ready = area is not None and area.type == "IMAGE_EDITOR" and area.spaces.active.ui_mode == "PAINT"
        if not ready or context.workspace.tools.from_space_image_mode("PAINT") is None:
            cls.poll_message_set(translated("Set the Image Editor's mode to Paint"))
            return False
        return True

    @refusing(RuntimeError)  # such as that the list of assets is not complete yet
    def execute(self, context: bpy.types.Context) -> set[str]:
        """Choose the brush, a brush of our own, so that the user's brushes stay as they are."""
        brush = bpy.data.brushes.get(BRUSH) or bpy.data.brushes.new(BRUSH, mode="TEXTURE_PAINT")
        brush.blend = self.blend
        if bpy.app.version < (4, 3, 0):
            context.tool_settings.image_paint.brush = brush
            return {"FINISHED"}
        if brush.asset_data is None:
            brush.asset_mark()  # from Blender 4.3 on, brushes are assets, and only those can be chosen
        with in_area(context.area):
            bpy.ops.brush.asset_activate(asset_library_type="LOCAL", relative_asset_identifier=f"Brush/{BRUSH}")
        return {"FINISHED"}


class IRGSPP_OT_save_masks(bpy.types.Operator):
    """Write the masks that you have painted on into the captured dataset, where the reconstruction reads them."""

    bl_idname = "irgspp.save_masks"
    bl_label = "Save Masks"
    bl_options = {"REGISTER"}  # noqa: RUF012 (Blender wants a plain set)

    @refusing()
    def execute(self, context: bpy.types.Context) -> set[str]:
        """Write the masks."""
        written = save_masks()
        self.report({"INFO"}, translated("1 mask saved" if len(written) == 1 else "{count} masks saved", count=len(written)))
        return {"FINISHED"}


class IRGSPP_OT_show_image(bpy.types.Operator):
    """Show an image file in an Image Editor."""

    bl_idname = "irgspp.show_image"
    bl_label = "Show Image"
    bl_options = {"REGISTER", "INTERNAL"}  # noqa: RUF012 (Blender wants a plain set)

    filepath: StringProperty(name="Image", description="Image file", subtype="FILE_PATH", options=SKIP)

    def execute(self, context: bpy.types.Context) -> set[str]:
        """Load the image, or load it again, and show it."""
        file = Path(bpy.path.abspath(self.filepath)).absolute()
        if not file.is_file():
            return refuse(self, InputError(file, "no such file", "capture the photographs again"))
        image = bpy.data.images.load(str(file), check_existing=True)
        image.reload()
        if not bpy.app.background:
            fit_image(open_image_editor(image))
        return {"FINISHED"}


CLASSES = (IRGSPP_OT_edit_mask, IRGSPP_OT_mask_brush, IRGSPP_OT_save_masks, IRGSPP_OT_show_image)
