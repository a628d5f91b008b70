# SPDX-License-Identifier: GPL-3.0-or-later
"""Driver of a Blender window: images, real mouse and keyboard input, and waiting while Blender runs.

A story is a generator: each `yield SECONDS` returns control to Blender for that time. Coordinates begin at the lower left.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import time
import traceback
from collections.abc import Callable, Generator, Iterator
from pathlib import Path

import bpy
import timing
from extension import MODULE, extension_module  # noqa: F401 (offered to the stories)

sys.stdout.reconfigure(line_buffering=True)  # type: ignore[union-attr]  # Blender is ended by os._exit, without flushing
OUTPUT, ENGINE = Path(sys.argv[-2]), sys.argv[-1]
AGAIN = os.environ.get("IRGSPP_AGAIN") == "1"  # in the second Blender of a story, see `quit_and_go_on`
presses = 0  # of mouse buttons and keys so far
STEP = 10  # pixels between places that are searched for a button: less than its height


def run_story(story: Callable[[], Iterator[float]]) -> None:
    """Run a story in the window's event loop, write its result, and quit Blender."""
    steps = story()

    def go_on() -> float | None:
        """Run the story to its next pause."""
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
    """Write the result of the story and quit Blender."""
    partial = OUTPUT / "end.part"
    result = {"error": error, "figures": timing.figures, "slowest": timing.summary()}
    partial.write_text(json.dumps(result, indent=1))
    os.replace(partial, OUTPUT / "end.json")
    bpy.app.timers.register(lambda: os._exit(0), first_interval=1.0)  # without asking about unsaved changes


def quit_and_go_on() -> None:
    """Quit Blender as the user does; the story is run in another one, with AGAIN."""
    (OUTPUT / "again").touch()
    bpy.ops.wm.quit_blender()


def window() -> bpy.types.Window:
    """Return the first window."""
    return bpy.context.window_manager.windows[0]


def view3d() -> bpy.types.Area:
    """Return the largest 3D View."""
    return max((area for area in window().screen.areas if area.type == "VIEW_3D"), key=lambda area: area.width * area.height)


def region(kind: str = "UI", area: bpy.types.Area | None = None) -> bpy.types.Region:
    """Return a region of an area.

    Args:
        kind: type of the region.
        area: area; None: the 3D View.
    """
    return next(part for part in (area or view3d()).regions if part.type == kind)


def override(kind: str = "WINDOW", area: bpy.types.Area | None = None):
    """Return a context override for operators in a region.

    Args:
        kind: type of the region.
        area: area; None: the 3D View.
    """
    place = area or view3d()
    return bpy.context.temp_override(window=window(), screen=window().screen, area=place, region=region(kind, place))


def redraw() -> None:
    """Redraw all areas."""
    for one in bpy.context.window_manager.windows:
        for area in one.screen.areas:
            area.tag_redraw()


def shot(name: str, box: tuple[int, int, int, int] | None = None) -> Path:
    """Write an image of the screen or of a part of it.

    Args:
        name: name of the image.
        box: x, y, width and height in pixels, with y from the top; None: everything.

    Returns:
        The file.
    """
    path = OUTPUT / f"{name}.png"
    crop = ["-crop", "{2}x{3}+{0}+{1}".format(*box), "+repage"] if box else []
    subprocess.run(["import", "-window", "root", *crop, str(path)], check=True)
    return path


def sidebar_shot(name: str) -> Path:
    """Write an image of the sidebar."""
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
        except TypeError:  # tabs are known after the first drawing
            continue
        if region().active_panel_category == tab:
            redraw()
            yield 1.0
            return
    raise RuntimeError(f"the sidebar has no tab {tab}")


def wait(condition: Callable[[], object], timeout: float = 120.0, step: float = 0.25) -> Iterator[float]:
    """Wait until a condition holds.

    Args:
        condition: function without arguments.
        timeout: seconds.
        step: seconds between calls.

    Raises:
        TimeoutError: where it does not hold in time.
    """
    end = time.monotonic() + timeout
    while not condition():
        if time.monotonic() > end:
            raise TimeoutError(f"the condition does not hold after {timeout:g} s")
        yield step


def move(x: float, y: float) -> subprocess.Popen:
    """Begin to move the mouse, in two steps, because Blender looks for the button below when the mouse moves; return the moving process.

    Args:
        x: pixels from the left.
        y: pixels from below.
    """
    top = window().height - y
    return subprocess.Popen(
        ["xdotool", "mousemove", f"{x - 2:.0f}", f"{top - 1:.0f}", "sleep", "0.03", "mousemove", f"{x:.0f}", f"{top:.0f}"]
    )


def moved(x: float, y: float) -> Iterator[float]:
    """Move the mouse, and wait until it is there, which takes a while on a busy machine.

    Args:
        x: pixels from the left.
        y: pixels from below.
    """
    process = move(x, y)
    while process.poll() is None:
        yield 0.02
    yield 0.12


def click_at(x: float, y: float) -> Iterator[float]:
    """Click at a place in the window.

    Args:
        x: pixels from the left.
        y: pixels from below.
    """
    yield from moved(x, y)
    yield 0.4
    click_here()
    yield 1.0


def click_here(button: int = 1) -> None:
    """Click where the mouse is."""
    global presses
    presses += 1
    subprocess.Popen(["xdotool", "mousedown", str(button), "sleep", "0.15", "mouseup", str(button)])


def press(event: str, button: int = 1) -> None:
    """Hold or release a mouse button where the mouse is, for a drag.

    Args:
        event: "mousedown" or "mouseup".
        button: 1 for the left one.
    """
    global presses
    presses += event == "mousedown"
    subprocess.Popen(["xdotool", event, str(button)])


def key(name: str) -> None:
    """Press a key."""
    global presses
    presses += 1
    subprocess.Popen(["xdotool", "key", name])


def write(text: str) -> None:
    """Type a text."""
    subprocess.Popen(["xdotool", "type", "--delay", "60", text])


def under_mouse(kind: str = "UI", area: bpy.types.Area | None = None) -> str:
    """Return the command (`bpy.ops.render.render()`) or data path of the button below the mouse, or "".

    Args:
        kind: type of the region.
        area: area; None: the 3D View.
    """
    with override(kind, area):
        for copy in (bpy.ops.ui.copy_python_command_button, bpy.ops.ui.copy_data_path_button):
            if copy.poll():  # as Ctrl-C over a button does
                copy()
                return bpy.context.window_manager.clipboard
    return ""


def is_button(copied: str, button: str, part: str) -> bool:
    """Return True where a command or data path is that of a button.

    Args:
        copied: command or data path.
        button: operator (`render.render`) or property (`preset`).
        part: text in the command, such as the value of an argument.
    """
    name = copied.partition("(")[0].removeprefix("bpy.ops.") if copied.startswith("bpy.ops.") else copied.rpartition(".")[2]
    return name == button and part in copied


def find(
    button: str, kind: str = "UI", area: bpy.types.Area | None = None, across: float = 0.4, part: str = ""
) -> Generator[float, None, tuple[float, float]]:
    """Move the mouse down a region until it is over a button.

    Args:
        button: operator or property of the button.
        kind: type of the region.
        area: area; None: the 3D View.
        across: place across the region, 0..1.
        part: text in the button's command, where several buttons have the operator.

    Returns:
        The place of the mouse.

    Raises:
        RuntimeError: where there is no such button.
    """
    place = region(kind, area)
    x, y = place.x + across * place.width, place.y + place.height - 4
    while y > place.y:
        yield from moved(x, y)
        if is_button(under_mouse(kind, area), button, part):
            yield 0.5  # on a busy machine the answer may be about the place before
            if is_button(under_mouse(kind, area), button, part):
                return x, y
        y -= STEP
    raise RuntimeError(f"no button {button} is visible")


def click(button: str, kind: str = "UI", area: bpy.types.Area | None = None, across: float = 0.4, part: str = "") -> Iterator[float]:
    """Click on a button.

    Args:
        button: operator or property of the button.
        kind: type of the region.
        area: area; None: the 3D View.
        across: place across the region, 0..1.
        part: text in the button's command, where several buttons have the operator.
    """
    yield from find(button, kind, area, across, part)
    click_here()
    yield 1.0
