# SPDX-License-Identifier: GPL-3.0-or-later
"""Story of an asset library (run.py --run): mark the object as asset, append it, drag it linked into another file, relight both."""

import os
import shutil
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path

sys.path.insert(0, os.path.dirname(os.path.abspath(__file__)))

import bpy
import browsing
import driver
import numpy as np
import preview
import timing

LIBRARY = "Reconstructions"  # name of the asset library
SEEN = 0.02  # of the preview's pixels, at least


def story() -> Iterator[float]:
    """Run the story."""
    work = Path(tempfile.mkdtemp(prefix="irgspp-story-"))
    run = Path(shutil.copytree(os.environ["IRGSPP_RUN"], work / "run"))
    (work / "library").mkdir()
    timing.time_callbacks()
    yield from browsing.engine_ready()
    file = work / "library" / "object.blend"
    name = yield from make_asset(run, file)
    yield from append(file, name)
    yield from relight("63_appended_relit")
    yield from drag_linked(file.parent)
    yield from override()
    yield from relight("67_override_relit")
    yield from move_and_relight()
    shutil.rmtree(work, ignore_errors=True)


def make_asset(run: Path, file: Path) -> Iterator[float]:
    """Import the run into a new file in the library's folder, mark the object as asset by its button, and return its name.

    Args:
        run: run folder.
        file: the file to save.
    """
    bpy.ops.wm.save_as_mainfile(filepath=str(file))
    browsing.open_panels("IRGSPP_PT_asset")
    yield from driver.open_sidebar("IRGS++")
    with driver.override():
        bpy.ops.irgspp.import_run("INVOKE_DEFAULT", directory=str(run))
    yield from driver.wait(lambda: bpy.context.object and bpy.context.object.type == "MESH", 60)
    thing = bpy.context.object
    yield from browsing.press_button("irgspp.mark_asset")
    yield 1.0
    driver.key("Return")
    (collection,) = thing.users_collection
    yield from driver.wait(lambda: collection.asset_data is not None, 60)
    bpy.ops.wm.save_mainfile()
    return thing.name


def append(file: Path, name: str) -> Iterator[float]:
    """Append the object to a new file by File > Append and the file browser.

    Args:
        file: the library's file.
        name: name of the object.
    """
    yield from new_file()
    yield from browsing.from_menu(45, "Append")
    yield from browsing.confirm_files("61_append", directory=file / "Object", file=name)
    yield from driver.wait(lambda: objects(), 60)
    yield from browsing.frame_selected()
    driver.shot("62_appended")
    (thing,) = objects()
    assert thing.library is None and thing.data.library is None, "it is linked"
    assert_textures(thing)


def drag_linked(folder: Path) -> Iterator[float]:
    """Drag the collection from the Asset Browser, set to link, into the 3D View of a new file, where it becomes an instance.

    Args:
        folder: of the asset library.
    """
    yield from new_file()
    bpy.ops.preferences.asset_library_add(directory=str(folder))
    bpy.context.preferences.filepaths.asset_libraries[-1].name = LIBRARY
    area = browsing.open_editor("ASSETS", "HORIZONTAL")
    yield 2.0
    area.spaces.active.params.asset_library_reference = LIBRARY
    area.spaces.active.params.import_method = "LINK"
    yield 6.0  # the library is read in the background
    driver.shot("64_asset_browser")
    place, view = driver.region("WINDOW", area), driver.region("WINDOW")
    yield from drag(place.x + 50, place.y + place.height - 50, view.x + 0.35 * view.width, view.y + 0.5 * view.height)
    yield from driver.wait(lambda: instances(), 60)
    yield 1.0
    driver.shot("65_linked")
    (instance,) = instances()
    assert instance.instance_collection.library is not None, "it is not linked"
    (thing,) = [part for part in instance.instance_collection.all_objects if part.type == "MESH"]
    assert_textures(thing)


def override() -> Iterator[float]:
    """Make a library override of the linked collection, as Object > Library Override does with its instance."""
    (thing,) = instances()
    bpy.context.view_layer.objects.active = thing
    thing.select_set(True)
    with driver.override():
        bpy.ops.object.make_override_library()
    yield 1.0
    (thing,) = objects()
    bpy.context.view_layer.objects.active = thing
    assert thing.override_library is not None, "there is no override"
    thing.select_set(True)
    yield from browsing.frame_selected()


def relight(image: str) -> Iterator[float]:
    """Relight the object by the preview's button under the World, and check that it is seen.

    Args:
        image: name of the image of the window.
    """
    yield from driver.open_sidebar("IRGS++")
    yield from browsing.press_button("irgspp.relight_preview")
    yield from preview.finished()
    yield 1.0
    driver.shot(image)
    assert seen() > SEEN, seen()


def move_and_relight() -> Iterator[float]:
    """Move the override, which the preview has to follow."""
    before = preview.pixels()
    (thing,) = objects()
    thing.location.x += 0.3 * max(thing.dimensions)
    yield from preview.updated(before)
    driver.shot("68_moved")
    assert seen() > SEEN, seen()


def new_file() -> Iterator[float]:
    """Open a new file without the default cube, with the sidebar at its tab."""
    yield from browsing.close_other_windows()
    with driver.override():
        bpy.ops.wm.read_homefile()
    yield 2.0
    for name in ("Cube", "Light"):
        bpy.data.objects.remove(bpy.data.objects[name])
    bpy.context.scene.irgspp.preview_resolution = 192
    yield from driver.open_sidebar("IRGS++")


def drag(x: float, y: float, to_x: float, to_y: float) -> Iterator[float]:
    """Drag the mouse from one place in the window to another.

    Args:
        x: pixels from the left.
        y: pixels from below.
        to_x: end, pixels from the left.
        to_y: end, pixels from below.
    """
    yield from driver.moved(x, y)
    yield 0.5
    driver.press("mousedown")
    for share in np.linspace(0.1, 1.0, 10):
        yield 0.2
        yield from driver.moved(x + share * (to_x - x), y + share * (to_y - y))
    yield 1.0
    driver.press("mouseup")
    yield 1.0


def objects() -> list[bpy.types.Object]:
    """Return the scene's meshes."""
    return [thing for thing in bpy.context.scene.objects if thing.type == "MESH"]


def instances() -> list[bpy.types.Object]:
    """Return the scene's instances of collections."""
    return [thing for thing in bpy.context.scene.objects if thing.instance_collection is not None]


def assert_textures(thing: bpy.types.Object) -> None:
    """Check that all textures of an object are found."""
    images = [node.image for node in thing.active_material.node_tree.nodes if node.bl_idname == "ShaderNodeTexImage"]
    assert images and all(image.has_data or image.size[0] > 0 for image in images), [image.filepath for image in images]


def seen() -> float:
    """Return the fraction of the preview's pixels that the object covers."""
    return float((preview.pixels()[..., 3] > 0.5).mean())


driver.run_story(story)
