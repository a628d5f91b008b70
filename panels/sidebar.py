# SPDX-License-Identifier: GPL-3.0-or-later
"""What the panels share: their place in Blender's window, wrapped text, buttons with their words."""

from __future__ import annotations

import textwrap
from typing import Any

import bpy

LETTER = 6.3  # pixels of an average letter at a scale of 1: lines are rather broken too early than cut off


class SidebarPanel:
    """A panel in the tab "IRGS++" of the 3D View's sidebar."""

    bl_space_type = "VIEW_3D"
    bl_region_type = "UI"
    bl_category = "IRGS++"


def say(layout: bpy.types.UILayout, context: bpy.types.Context, text: str, icon: str = "NONE", width: float = 1.0) -> None:
    """Words over as many lines as a part `width` of the sidebar needs; `icon` stands before the first."""
    column = layout.column(align=True)
    column.scale_y = 0.8
    for row, line in enumerate(textwrap.wrap(text, max(8, int(width * letters(context, with_icon=icon != "NONE"))))):
        column.label(text=line, icon=icon if row == 0 else ("NONE" if icon == "NONE" else "BLANK1"))


def letters(context: bpy.types.Context, with_icon: bool = False) -> int:
    """How many letters a line of the sidebar holds; 40 where there is no sidebar."""
    region = context.region
    if region is None:
        return 40
    scale = context.preferences.system.ui_scale
    return max(16, int((region.width / scale - (98 if with_icon else 72)) / LETTER))


def button(layout: bpy.types.UILayout, operator: str, text: str | None = None, icon: str = "NONE", **properties: Any) -> None:
    """A button with its operator's properties; without `text` it has the operator's own label ("": the icon alone)."""
    words = {} if text is None else {"text": text}
    pressed = layout.operator(operator, icon=icon, **words)
    for name, value in properties.items():
        setattr(pressed, name, value)


def settings_column(layout: bpy.types.UILayout) -> bpy.types.UILayout:
    """A column of properties, labels left and values right, that are no keyframes."""
    layout.use_property_split, layout.use_property_decorate = True, False
    return layout.column()


def seconds_in_words(seconds: float) -> str:
    """8 s, 3:05 min, 2:07 h."""
    whole = max(0, round(seconds))
    if whole < 60:
        return f"{whole} s"
    if whole < 3600:
        return f"{whole // 60}:{whole % 60:02d} min"
    return f"{whole // 3600}:{whole % 3600 // 60:02d} h"
