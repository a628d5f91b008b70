# SPDX-License-Identifier: GPL-3.0-or-later
"""Eyes and driver inside a Blender window: images, real mouse and keys, and waiting while Blender goes on.

A story is a generator: each `yield SECONDS` gives the time back to Blender. Coordinates are Blender's, with the origin below left.
"""

from __future__ import annotations

import json
import os
import statistics
import subprocess
import sys
import time
import traceback
from collections.abc import Callable, Iterator
from pathlib import Path
from types import ModuleType

import bpy

sys.stdout.reconfigure(line_buffering=True)  # type: ignore[union-attr]  # Blender is ended without ceremony
OUTPUT, ENGINE = Path(sys.argv[-2]), sys.argv[-1]
MODULE = "bl_ext.user_default.irgspp"  # name of the installed extension
STEP = 7  # pixels between places that are looked at for a button: less than its height


def run_story(story: Callable[[], Iterator[float]]) -> None:
    """Run a story in the window's event loop, write down how it ended, and quit."""
    steps = story()

    def go_on() -> float | None:
        try:
            return next(steps)
        except StopIteration:
            _end(None)
        except BaseException:
            traceback.print_exc()
            shot("failed")
            _end(traceback.format_exc())
        return None

    bpy.app.timers.register(go_on, first_interval=2.0, persistent=True)


def _end(error: str | None) -> None:
    partial = OUTPUT / "end.part"
    slowest = {
        name: f"{max(seconds) * 1000:.1f} ms, median {statistics.median(seconds) * 1000:.2f} ms of {len(seconds)}"
        for name, seconds in _times.items()
        if seconds
    }
    partial.write_text(json.dumps({"error": error, "slowest": slowest}, indent=1))
    os.replace(partial, OUTPUT / "end.json")
    bpy.app.timers.register(lambda: os._exit(0), first_interval=1.0)  # no question about an unsaved file


_times: dict[str, list[float]] = {}


def time_calls(owner: object, name: str, label: str) -> None:
    """From now on note how much processor time each call of a method takes: that long Blender could not answer."""
    method, seconds = getattr(owner, name), _times.setdefault(label, [])

    def timed(*args: object) -> object:
        began = time.thread_time()
        try:
            return method(*args)
        finally:
            seconds.append(time.thread_time() - began)

    # Blender driver over as many arguments as the method's code says it takes.
    takes = {0: lambda: timed(), 2: lambda self, context: timed(self, context), 3: lambda self, context, event: timed(self, context, event)}
    setattr(owner, name, takes[method.__code__.co_argcount])


def extension_module(name: str) -> ModuleType:
    """Return a loaded module of the extension by its name below the extension, such as `irgspp_addon.jobs.queue`."""
    return sys.modules[f"{MODULE}.{name}"]


def window() -> bpy.types.Window:
    return bpy.context.window_manager.windows[0]


def view3d() -> bpy.types.Area:
    return max((area for area in window().screen.areas if area.type == "VIEW_3D"), key=lambda area: area.width * area.height)


def region(kind: str = "UI", area: bpy.types.Area | None = None) -> bpy.types.Region:
    return next(part for part in (area or view3d()).regions if part.type == kind)


def override(kind: str = "WINDOW", area: bpy.types.Area | None = None):
    place = area or view3d()
    return bpy.context.temp_override(window=window(), screen=window().screen, area=place, region=region(kind, place))


def redraw() -> None:
    for one in bpy.context.window_manager.windows:
        for area in one.screen.areas:
            area.tag_redraw()


def shot(name: str, box: tuple[int, int, int, int] | None = None) -> Path:
    """An image of the window as it is now, or of a part of it: x, y, width, height with y from the top."""
    path = OUTPUT / f"{name}.png"
    crop = ["-crop", "{2}x{3}+{0}+{1}".format(*box), "+repage"] if box else []
    subprocess.run(["import", "-window", "root", *crop, str(path)], check=True)
    return path


def sidebar_shot(name: str) -> Path:
    """An image of the sidebar alone."""
    part = region("UI")
    return shot(name, (part.x, window().height - part.y - part.height, part.width, part.height))


def open_sidebar(tab: str) -> Iterator[float]:
    """Show the 3D View's sidebar at a tab."""
    view3d().spaces[0].show_region_ui = True
    for _ in range(20):
        redraw()
        yield 0.3
        try:
            region().active_panel_category = tab
        except TypeError:  # its tabs are known once it was drawn
            continue
        if region().active_panel_category == tab:
            redraw()
            yield 1.0
            return
    raise RuntimeError(f"the sidebar has no tab {tab}")


def wait(condition: Callable[[], object], timeout: float = 120.0, step: float = 0.25) -> Iterator[float]:
    """Until the condition holds."""
    end = time.monotonic() + timeout
    while not condition():
        if time.monotonic() > end:
            raise TimeoutError(f"not so after {timeout:g} s")
        yield step


def move(x: float, y: float) -> None:
    """The mouse, in two steps: Blender looks for the button below when it moves."""
    top = window().height - y
    subprocess.Popen(["xdotool", "mousemove", f"{x - 2:.0f}", f"{top - 1:.0f}", "sleep", "0.03", "mousemove", f"{x:.0f}", f"{top:.0f}"])


def click_at(x: float, y: float) -> Iterator[float]:
    """A real click at a place in the window."""
    move(x, y)
    yield 0.5
    click_here()
    yield 1.0


def click_here(button: int = 1) -> None:
    subprocess.Popen(["xdotool", "mousedown", str(button), "sleep", "0.15", "mouseup", str(button)])


def key(name: str) -> None:
    subprocess.Popen(["xdotool", "key", name])


def write(text: str) -> None:
    """Real keys, one after another."""
    subprocess.Popen(["xdotool", "type", "--delay", "60", text])


def under_mouse(kind: str = "UI", area: bpy.types.Area | None = None) -> str:
    """The operator (`render.render`) or property (`preset`) of the button below the mouse, or ""."""
    clipboard = bpy.context.window_manager
    with override(kind, area):
        if bpy.ops.ui.copy_python_command_button.poll():  # what a person copies by Ctrl-C over a button
            bpy.ops.ui.copy_python_command_button()
            return clipboard.clipboard.partition("(")[0].removeprefix("bpy.ops.")
        if bpy.ops.ui.copy_data_path_button.poll():
            bpy.ops.ui.copy_data_path_button()
            return clipboard.clipboard.rpartition(".")[2]
    return ""


def find(wanted: str, kind: str = "UI", area: bpy.types.Area | None = None, across: float = 0.4) -> Iterator[float]:
    """Move the mouse down the region until it is over the button of that operator or property."""
    part = region(kind, area)
    x, y = part.x + across * part.width, part.y + part.height - 4
    while y > part.y:
        move(x, y)
        yield 0.12
        if under_mouse(kind, area) == wanted:
            return
        y -= STEP
    raise RuntimeError(f"no button {wanted} is to be seen")


def click(wanted: str, kind: str = "UI", area: bpy.types.Area | None = None, across: float = 0.4) -> Iterator[float]:
    """A real click on the button of an operator or property."""
    yield from find(wanted, kind, area, across)
    click_here()
    yield 1.0
