# SPDX-License-Identifier: GPL-3.0-or-later
"""Parts that panels share: base class, wrapped text, buttons."""

from __future__ import annotations

from collections.abc import Iterator
from functools import lru_cache
from typing import Any

import blf
import bpy

from ..irgspp_addon.translations import translated

FONT = 0  # Blender's own, of its interface
MARGIN, ICON = 72, 26  # pixels at scale 1 beside the text: tabs and borders, and an icon
LEAST = 100.0  # width of a text at least, pixels at scale 1


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
    size = context.preferences.ui_styles[0].widget.points
    for row, line in enumerate(wrapped(translated(text), width * room(context, with_icon=icon != "NONE"), size)):
        column.label(text=line, icon=icon if row == 0 else ("NONE" if icon == "NONE" else "BLANK1"))


def room(context: bpy.types.Context, with_icon: bool = False) -> float:
    """Return the width of a line of text in the sidebar, in pixels at scale 1; a usual one where there is no sidebar.

    Args:
        context: of the panel.
        with_icon: the line begins with an icon.
    """
    width = 280.0 if context.region is None else context.region.width / context.preferences.system.ui_scale
    return max(LEAST, width - MARGIN - (ICON if with_icon else 0))


@lru_cache(maxsize=512)
def wrapped(text: str, width: float, size: float) -> tuple[str, ...]:
    """Return the lines of a text, none of which is wider than it may be.

    Args:
        text: to wrap at its spaces; a longer word, such as a path, within itself.
        width: of a line, pixels at scale 1.
        size: of the interface's font.
    """
    blf.size(FONT, size)
    lines = [""]
    for word in text.split():
        longer = f"{lines[-1]} {word}".strip()
        if blf.dimensions(FONT, longer)[0] <= width:
            lines[-1] = longer
        else:
            lines += _pieces(word, width)
    return tuple(line for line in lines if line)


def _pieces(word: str, width: float) -> Iterator[str]:
    """Yield a word in pieces that fit in a line: itself where it fits."""
    while word:
        fits = len(word)
        while fits > 1 and blf.dimensions(FONT, word[:fits])[0] > width:
            fits -= 1
        yield word[:fits]
        word = word[fits:]


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
