# SPDX-License-Identifier: GPL-3.0-or-later
"""Panel in the Image Editor's sidebar while a mask is painted."""

from __future__ import annotations

import bpy

from ..irgspp_addon.importer.mask_image import MASK
from .sidebar import button, say


class IRGSPP_PT_mask(bpy.types.Panel):
    """Panel that paints and saves the mask of a captured photograph."""

    bl_label = "Mask"
    bl_space_type = "IMAGE_EDITOR"
    bl_region_type = "UI"
    bl_category = "IRGS++"

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """Return True where the editor shows a mask."""
        image = getattr(context.space_data, "image", None)
        return image is not None and MASK in image

    def draw(self, context: bpy.types.Context) -> None:
        """Draw the two ways to paint, and the button that saves."""
        layout = self.layout
        say(layout, context, "The object is opaque, the rest is dim.", icon="INFO")
        row = layout.row(align=True)
        button(row, "irgspp.mask_brush", "Erase", "REMOVE", blend="ERASE_ALPHA")
        button(row, "irgspp.mask_brush", "Add", "ADD", blend="ADD_ALPHA")
        brush = context.tool_settings.image_paint.brush
        layout.label(text=BRUSHES.get(brush.blend if brush else "", "Press Erase or Add, then paint."))
        button(layout, "irgspp.save_masks", "Save Masks", "FILE_TICK")


BRUSHES = {"ERASE_ALPHA": "The brush erases.", "ADD_ALPHA": "The brush adds."}

CLASSES = (IRGSPP_PT_mask,)
