# SPDX-License-Identifier: GPL-3.0-or-later
"""Controls that are not directly visible: menus, the file browser, buttons of a scrolled sidebar, windows of their own."""

from __future__ import annotations

import os
import time
from collections.abc import Generator, Iterator
from pathlib import Path
from typing import Any

import bpy
import driver
import timing

FIRST_PICTURE = 10.0  # seconds from the start of a reconstruction to its first picture in the 3D View
PAGE = 15  # steps of scrolling that are less than the height of the sidebar


def from_menu(x: float, entry: str) -> Iterator[float]:
    """Choose an entry of a menu of the top bar by the menu's own search.

    Args:
        x: place of the menu in pixels from the left.
        entry: text of the entry.
    """
    yield from driver.click_at(x, driver.window().height - 12)
    driver.key("space")
    yield 1.0
    driver.write(entry)
    yield 2.0
    driver.shot(f"30_menu_{entry.split()[-1]}")
    driver.key("Return")
    yield 0.5


def confirm_files(name: str, directory: Path | None = None, file: str = "") -> Iterator[float]:
    """Fill in the file browser, take an image of it, and confirm.

    Args:
        name: name of the image.
        directory: folder to choose; None: the one shown.
        file: name of the file; "" for the one shown.
    """
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
    """Return the window and the area of the open file browser; None where there is none."""
    for window in bpy.context.window_manager.windows:
        for area in window.screen.areas:
            if area.type == "FILE_BROWSER":
                return window, area
    return None


def close_other_windows() -> Iterator[float]:
    """Close all windows but the first."""
    for window in list(bpy.context.window_manager.windows)[1:]:
        with bpy.context.temp_override(window=window):
            bpy.ops.wm.window_close()
    yield 1.0


def open_panels(*names: str) -> None:
    """Open panels that are closed by default, from their first drawing on."""
    for name in names:
        cls = getattr(bpy.types, name)
        bpy.utils.unregister_class(cls)
        cls.bl_options = set()
        bpy.utils.register_class(cls)


def reach(button: str, across: float = 0.4, part: str = "") -> Generator[float, None, tuple[float, float]]:
    """Move the mouse to a button, wherever the sidebar has to be scrolled to, and note how long it took.

    Args:
        button: operator or property of the button.
        across: place across the sidebar, 0..1.
        part: text in the button's command, where several buttons have the operator.

    Returns:
        The place of the mouse.

    Raises:
        RuntimeError: where there is no such button.
    """
    began = time.monotonic()
    place = yield from _find_scrolling(button, across, part)
    timing.searches.append(time.monotonic() - began)
    return place


def _find_scrolling(button: str, across: float, part: str) -> Generator[float, None, tuple[float, float]]:
    """Find a button in what the sidebar shows, then from its top to its end."""
    try:
        return (yield from driver.find(button, across=across, part=part))
    except RuntimeError:
        yield from scrolled("scroll_up")
    while True:
        try:
            return (yield from driver.find(button, across=across, part=part))
        except RuntimeError:
            before = driver.region().view2d.region_to_view(0, 0)
            yield from scrolled("scroll_down", PAGE)
            if driver.region().view2d.region_to_view(0, 0) == before:  # the end
                raise


def press_button(button: str, across: float = 0.4, part: str = "") -> Iterator[float]:
    """Click on a button, wherever the sidebar has to be scrolled to.

    Args:
        button: operator or property of the button.
        across: place across the sidebar, 0..1.
        part: text in the button's command, where several buttons have the operator.
    """
    yield from reach(button, across, part)
    driver.click_here()
    yield 1.0


def choose_hdri(image: str) -> Iterator[float]:
    """Choose the second of the HDRIs by its thumbnail: a click on the chosen one, and a click in the pop-up.

    Args:
        image: name of the image of the pop-up.
    """
    before, place = bpy.context.scene.world, driver.region()
    x, y = yield from reach("irgspp.open_hdri", across=0.25)
    yield from driver.click_at(x, y + 70)  # the thumbnail above that button is none that Blender tells the name of
    yield 5.0  # thumbnails are made in the background
    driver.shot(image)
    yield from driver.click_at(place.x + place.width - 720, y - 50)  # the second of eight in the pop-up's first row
    yield from driver.wait(lambda: bpy.context.scene.world != before, 10)


def engine_ready() -> Iterator[float]:
    """Choose the engine in the preferences and wait until it has been checked, which begins by itself."""
    bpy.context.preferences.addons[driver.MODULE].preferences.engine_python = driver.ENGINE
    yield from driver.wait(lambda: driver.extension_module("irgspp_addon.engine.process").status().state == "ok", 120)
    yield 1.0


def show_properties(tab: str) -> Iterator[float]:
    """Show a tab of the Properties editor, such as "WORLD"."""
    area = next(area for area in driver.window().screen.areas if area.type == "PROPERTIES")
    area.spaces.active.context = tab
    area.tag_redraw()
    yield 1.0


def started_job() -> Generator[float, None, Any]:
    """Wait until a job of the extension runs, and return it."""
    queue = driver.extension_module("irgspp_addon.jobs.queue")
    yield from driver.wait(queue.running, 30)
    return queue.running()[0]


def in_progress() -> list[bpy.types.Object]:
    """Return what the scene shows of a running reconstruction."""
    return [thing for thing in bpy.context.scene.objects if thing.name.endswith("(in progress)")]


def first_picture(job: Any, image: str) -> Iterator[float]:
    """Wait until the scene shows the first points of a reconstruction that was just started, and check how long that took.

    Args:
        job: the reconstruction.
        image: name of the image of the window.
    """
    timing.begin()
    yield from driver.wait(lambda: job.finished or any(thing.visible_get() for thing in in_progress()), 600, step=0.1)
    yield 0.3  # it is drawn
    timing.within("first picture", time.time() - job.made, FIRST_PICTURE)
    driver.shot(image)


def trained(job: Any) -> Iterator[float]:
    """Wait until a reconstruction has ended well, and check that nothing blocked Blender before its result arrived."""
    slowest = timing.slowest_call()

    def ended() -> bool:
        """Return True at the job's end."""
        nonlocal slowest
        if not job.finished:
            slowest = timing.slowest_call()
        return job.finished

    yield from driver.wait(ended, 1800, step=0.1)
    assert job.state == "done" and not job.error, (job.state, job.error)
    timing.check_never_blocked(slowest)
    yield 2.0


def new_world(name: str) -> bpy.types.World:
    """Return a new World with a node tree."""
    world = bpy.data.worlds.new(name)
    if bpy.app.version < (5, 0, 0):
        world.use_nodes = True
    return world


def frame_selected() -> Iterator[float]:
    """Frame the selected objects in the 3D View."""
    with driver.override():
        bpy.ops.view3d.view_selected()
    yield 1.0


def open_editor(kind: str, direction: str = "VERTICAL") -> bpy.types.Area:
    """Open another editor in a part of the 3D View's area.

    Args:
        kind: type of the editor, such as "IMAGE_EDITOR".
        direction: "VERTICAL" for a part beside the view, "HORIZONTAL" for one below it.
    """
    before = {area.as_pointer() for area in driver.window().screen.areas}
    with driver.override():
        bpy.ops.screen.area_split(direction=direction, factor=0.4)
    new = next(area for area in driver.window().screen.areas if area.as_pointer() not in before)
    new.ui_type = kind
    return new


def scrolled(operator: str, steps: int = 120) -> Iterator[float]:
    """Scroll the sidebar down ("scroll_down") or up ("scroll_up").

    Args:
        operator: of the module `view2d`.
        steps: of 40 pixels; by default as many as lead to the end.
    """
    with driver.override("UI"):
        for _ in range(steps):
            getattr(bpy.ops.view2d, operator)()
    yield 1.0
