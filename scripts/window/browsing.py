# SPDX-License-Identifier: GPL-3.0-or-later
"""Ways to what is not in sight: menus, the file browser, buttons of a sidebar that scrolls, windows of their own."""

from __future__ import annotations

import os
import subprocess
from collections.abc import Generator, Iterator
from pathlib import Path
from typing import Any

import bpy
import driver


def from_menu(x: float, entry: str) -> Iterator[float]:
    """A click on a menu of the top bar, and its entry by the menu's own search."""
    yield from driver.click_at(x, driver.window().height - 12)
    driver.key("space")
    yield 1.0
    driver.write(entry)
    yield 2.0
    driver.shot(f"30_menu_{entry.split()[-1]}")
    driver.key("Return")
    yield 0.5


def confirm_files(name: str, directory: Path | None = None, file: str = "") -> Iterator[float]:
    """The file browser: an image of it, then Return with the mouse over it."""
    yield from driver.wait(file_area, 10)
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
    driver.shot(name)
    place = driver.region("EXECUTE", area)
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
            yield from driver.find(wanted, across=across)
            return
        except RuntimeError:
            if scroll == "scroll_up":
                raise


def press_button(wanted: str, across: float = 0.4) -> Iterator[float]:
    """A real click on a button wherever the sidebar has to be scrolled to."""
    yield from reach(wanted, across)
    driver.click_here()
    yield 1.0


def started_job() -> Generator[float, None, Any]:
    """Wait until a job of the extension runs, and return it."""
    queue = driver.extension_module("irgspp_addon.jobs.queue")
    yield from driver.wait(queue.running, 30)
    return queue.running()[0]


def new_world(name: str) -> bpy.types.World:
    """Return a new World with a node tree."""
    world = bpy.data.worlds.new(name)
    if bpy.app.version < (5, 0, 0):
        world.use_nodes = True
    return world


def frame_selected() -> Iterator[float]:
    with driver.override():
        bpy.ops.view3d.view_selected()
    yield 1.0


def scrolled(way: str) -> Iterator[float]:
    """The sidebar at its end ("scroll_down") or beginning."""
    with driver.override("UI"):
        for _ in range(60):
            getattr(bpy.ops.view2d, way)()
    yield 1.0
