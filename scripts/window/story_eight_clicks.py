# SPDX-License-Identifier: GPL-3.0-or-later
"""Story of the shortest way to a relit object: from Blender's open window, with an engine set up, to the demo under another light.

Each press of a mouse button or key counts, and each second, but that the robot looks for buttons more slowly than a person: a button counts
as found in `timing.FINDING` seconds.
"""

import os
import sys
import time
from collections.abc import Generator, Iterator

sys.path.insert(0, os.path.dirname(os.path.abspath(__file__)))

import bpy
import browsing
import driver
import numpy as np
import timing

MOST_CLICKS, MOST_SECONDS = 8, 180.0
CHANGED, COLOURED = 0.05, 0.05  # mean difference of the background under another light, and of the object's red, green and blue
TAB_STEP = 20  # pixels between places that are searched for the tab


def story() -> Iterator[float]:
    """Run the story."""
    timing.time_callbacks()
    yield from browsing.engine_ready()
    tab = yield from find_tab()
    driver.shot("90_open_window")
    began, presses, searches, computed_before = time.monotonic(), driver.presses, len(timing.searches), computed()
    yield from show_tab(*tab)
    yield from try_demo()
    at_result, engine_seconds = time.monotonic() - began, computed() - computed_before
    yield from relight()
    seconds, clicks = time.monotonic() - began, driver.presses - presses
    driver.shot("95_relit")
    timing.figures["clicks"] = f"{clicks} (limit {MOST_CLICKS})"
    timing.figures["to the result"] = (
        f"{at_result:.1f} s with the robot's search, of which the engine computed {engine_seconds:.0f} s on all processors together"
    )
    assert clicks <= MOST_CLICKS, timing.figures["clicks"]
    timing.within("to the relit object", timing.by_person(seconds, searches), MOST_SECONDS)


def computed() -> float:
    """Return the processor time of Blender's child processes that have ended, in seconds."""
    times = os.times()
    return times.children_user + times.children_system


def find_tab() -> Generator[float, None, tuple[float, float]]:
    """Find the place of the tab IRGS++ by clicking down the tabs, then show the first tab again and close the sidebar; return the place."""
    space = driver.view3d().spaces[0]
    yield from driver.open_sidebar("IRGS++")
    part = driver.region()
    part.active_panel_category = "Item"
    x, y = part.x + part.width - 10.0, part.y + part.height - 10.0
    while part.active_panel_category != "IRGS++":
        y -= TAB_STEP
        assert y > part.y, "there is no tab IRGS++"
        yield from driver.click_at(x, y)
    part.active_panel_category = "Item"
    space.show_region_ui = False
    yield 1.0
    return x, y


def show_tab(x: float, y: float) -> Iterator[float]:
    """Open the sidebar by its key, and click on the tab.

    Args:
        x: place of the tab in pixels from the left.
        y: place of the tab in pixels from below.
    """
    area = driver.view3d()
    driver.move(area.x + 0.4 * area.width, area.y + 0.3 * area.height)
    yield 0.5
    driver.key("n")
    yield from driver.wait(lambda: area.spaces[0].show_region_ui, 10)
    yield 1.0
    yield from driver.click_at(x, y)
    assert driver.region().active_panel_category == "IRGS++", driver.region().active_panel_category
    driver.shot("91_tab")


def try_demo() -> Iterator[float]:
    """Press the demo's button, wait for the first picture, and for the result in the scene."""
    yield from browsing.press_button("irgspp.demo")
    job = yield from browsing.started_job()
    yield from browsing.first_picture(job, "92_first_picture")
    yield from browsing.trained(job)
    driver.shot("93_result")


def relight() -> Iterator[float]:
    """Choose an HDRI by its thumbnail, and wait until the 3D View shows it, and the coloured object under it."""
    place = driver.region("WINDOW")
    corner = pixels(place, 0.1, 0.1)
    yield from browsing.choose_hdri("94_thumbnails")
    yield from driver.wait(lambda: np.abs(pixels(place, 0.1, 0.1) - corner).mean() > CHANGED, 300, step=0.5)
    yield from driver.wait(lambda: np.ptp(pixels(place, 0.45, 0.4), axis=1).mean() > COLOURED, 300, step=0.5)


def pixels(place: bpy.types.Region, x: float, y: float) -> np.ndarray:
    """Return what is seen in a part of a region, a fifth of its width and height: (N, 3), encoded as on the screen.

    Args:
        place: the region.
        x: left edge of the part, 0..1 of the region.
        y: lower edge of the part, 0..1 of the region.
    """
    width, height = place.width // 5, place.height // 5
    left, low = place.x + int(x * place.width), place.y + int(y * place.height)
    image = bpy.data.images.load(str(driver.shot("part", (left, driver.window().height - low - height, width, height))))
    values = np.array(image.pixels[:], np.float32).reshape(-1, 4)[:, :3]
    bpy.data.images.remove(image)
    return values


driver.run_story(story)
