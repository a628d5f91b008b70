# SPDX-License-Identifier: GPL-3.0-or-later
"""Choice of the preset by pictures: one object as the presets reconstruct it."""

from __future__ import annotations

from pathlib import Path

import bpy

from ..irgspp_addon.shared_properties import PRESETS
from .images import image

PICTURES = Path(__file__).resolve().parents[1] / "irgspp_addon" / "pictures"  # made by scripts/preset_pictures.py
HEIGHT = 3.0  # of a picture, rows of buttons
STAND_IN = "IMAGE_DATA"  # icon of a preset that has no picture: its schedule takes too long for one


def draw_presets(layout: bpy.types.UILayout, settings: bpy.types.PropertyGroup) -> None:
    """Draw a picture and a button for each preset.

    Args:
        layout: to draw into.
        settings: of the scene.
    """
    row = layout.row(align=True)
    for name, *_ in PRESETS:
        column = row.column(align=True)
        if not image(column, PICTURES / f"{name}.png", scale=HEIGHT):
            column.template_icon(icon_value=icon_number(STAND_IN), scale=HEIGHT)
        column.prop_enum(settings, "preset", name)


def icon_number(name: str) -> int:
    """Return the number of one of Blender's own icons."""
    return bpy.types.UILayout.bl_rna.functions["label"].parameters["icon"].enum_items[name].value
