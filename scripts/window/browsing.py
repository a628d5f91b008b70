# SPDX-License-Identifier: GPL-3.0-or-later
"""Ways to what is not in sight: menus, the file browser, buttons of a sidebar that scrolls, windows of their own."""

from __future__ import annotations

import os
import subprocess
from collections.abc import Iterator
from pathlib import Path

import bpy
import hands


def from_menu(x: float, entry: str) -> Iterator[float]:
    """A click on a menu of the top bar, and its entry by the menu's own search."""
    yield from hands.click_at(x, hands.window().height - 12)
    hands.key("space")
    yield 1.0
    hands.write(entry)
    yield 2.0
    hands.shot(f"30_menu_{entry.split()[-1]}")
    hands.key("Return")
    yield 0.5


def confirm_files(name: str, directory: Path | None = None, file: str = "") -> Iterator[float]:
    """The file browser: an image of it, then Return with the mouse over it."""
    yield from hands.wait(file_area, 10)
    yield 1.5
    found = file_area()
    assert found is not None, "the file browser is gone again"
    window, area = found
    params = area.spaces.active.params
    if directory is not None:
        params.directory = os.fsencode(str(directory))
    if file:
        params.filename = file
    area.tag_redraw()
    yield 1.5
    hands.shot(name)
    place = hands.region("EXECUTE", area)
    with bpy.context.temp_override(window=window, area=area, region=place):
        bpy.ops.file.execute("INVOKE_DEFAULT")
    yield 1.0


def file_area() -> tuple[bpy.types.Window, bpy.types.Area] | None:
    """The open file browser."""
    for window in bpy.context.window_manager.windows:
        for area in window.screen.areas:
            if area.type == "FILE_BROWSER":
                return window, area
    return None


def close_other_windows() -> Iterator[float]:
    for window in list(bpy.context.window_manager.windows)[1:]:
        with bpy.context.temp_override(window=window):
            bpy.ops.wm.window_close()
    yield 1.0


def below() -> Iterator[float]:
    """The mouse one button further down."""
    subprocess.Popen(["xdotool", "mousemove_relative", "--", "0", "18", "sleep", "0.1", "mousemove_relative", "--", "0", "2"])
    yield 0.5


def open_panels(*names: str) -> None:
    """Let panels that are closed at first be open from their first drawing on."""
    for name in names:
        cls = getattr(bpy.types, name)
        bpy.utils.unregister_class(cls)
        cls.bl_options = set()
        bpy.utils.register_class(cls)


def reach(wanted: str, across: float = 0.4) -> Iterator[float]:
    """Find a button wherever the sidebar has to be scrolled to."""
    for scroll in ("", "scroll_down", "scroll_up"):
        if scroll:
            yield from scrolled(scroll)
        try:
            yield from hands.find(wanted, across=across)
            return
        except RuntimeError:
            if scroll == "scroll_up":
                raise


def press_button(wanted: str, across: float = 0.4) -> Iterator[float]:
    """A real click on a button wherever the sidebar has to be scrolled to."""
    yield from reach(wanted, across)
    hands.click_here()
    yield 1.0


def frame_selected() -> Iterator[float]:
    with hands.override():
        bpy.ops.view3d.view_selected()
    yield 1.0


def scrolled(way: str) -> Iterator[float]:
    """The sidebar at its end ("scroll_down") or beginning."""
    with hands.override("UI"):
        for _ in range(60):
            getattr(bpy.ops.view2d, way)()
    yield 1.0
