# SPDX-License-Identifier: GPL-3.0-or-later
"""Parts that panels share: base class, wrapped text, buttons."""

from __future__ import annotations

import textwrap
from typing import Any

import bpy

from ..irgspp_addon.translations import translated

LETTER = 6.3  # average width of a letter at scale 1, pixels; on the large side, so that lines are never cut off


class SidebarPanel:
    """Base of panels in the tab "IRGS++" of the 3D View's sidebar."""

    bl_space_type = "VIEW_3D"
    bl_region_type = "UI"
    bl_category = "IRGS++"


def say(layout: bpy.types.UILayout, context: bpy.types.Context, text: str, icon: str = "NONE", width: float = 1.0) -> None:
    """Draw a text, in the language of the interface, over as many lines as it needs.

    Args:
        layout: to draw into.
        context: of the panel.
        text: to wrap.
        icon: in front of the first line.
        width: of the text, as a fraction of the sidebar's.
    """
    column = layout.column(align=True)
    column.scale_y = 0.8
    for row, line in enumerate(textwrap.wrap(translated(text), max(8, int(width * letters(context, with_icon=icon != "NONE"))))):
        column.label(text=line, icon=icon if row == 0 else ("NONE" if icon == "NONE" else "BLANK1"))


def letters(context: bpy.types.Context, with_icon: bool = False) -> int:
    """Return the number of letters that fit in a line of the sidebar; 40 where there is no sidebar.

    Args:
        context: of the panel.
        with_icon: the line begins with an icon.
    """
    region = context.region
    if region is None:
        return 40
    scale = context.preferences.system.ui_scale
    return max(16, int((region.width / scale - (98 if with_icon else 72)) / LETTER))


def button(layout: bpy.types.UILayout, operator: str, text: str | None = None, icon: str = "NONE", **properties: Any) -> None:
    """Draw a button.

    Args:
        layout: to draw into.
        operator: its bl_idname.
        text: label; None: the operator's own; empty: the icon alone.
        icon: in front of the label.
        **properties: values of the operator's properties.
    """
    label = {} if text is None else {"text": text}
    pressed = layout.operator(operator, icon=icon, **label)
    for name, value in properties.items():
        setattr(pressed, name, value)


def settings_column(layout: bpy.types.UILayout) -> bpy.types.UILayout:
    """Return a column for properties: labels left, values right, no keyframe buttons."""
    layout.use_property_split, layout.use_property_decorate = True, False
    return layout.column()


def seconds_in_words(seconds: float) -> str:
    """Return seconds as "8 s", "3:05 min" or "2:07 h"."""
    whole = max(0, round(seconds))
    if whole < 60:
        return f"{whole} s"
    if whole < 3600:
        return f"{whole // 60}:{whole % 60:02d} min"
    return f"{whole // 3600}:{whole % 3600 // 60:02d} h"
