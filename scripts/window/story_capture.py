# SPDX-License-Identifier: GPL-3.0-or-later
"""Story of bare photographs (run.py --photographs): find their cameras, look at masks and the object's sphere, reconstruct a draft."""

import json
import os
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path

sys.path.insert(0, os.path.dirname(os.path.abspath(__file__)))

import bpy
import browsing
import driver
import timing

PATIENCE = 3000.0  # seconds for a capture, and for a reconstruction
NO_PHOTOGRAPH = "notes.png"  # text file among the photographs


def story() -> Iterator[float]:
    """Run the story."""
    work = Path(tempfile.mkdtemp(prefix="irgspp-story-"))
    photographs = Path(shutil.copytree(os.environ["IRGSPP_PHOTOGRAPHS"], work / "photos"))
    (photographs / NO_PHOTOGRAPH).write_text("This is no photograph.")
    bpy.ops.wm.save_as_mainfile(filepath=str(work / "capture.blend"))
    for name in ("Cube", "Light", "Camera"):
        bpy.data.objects.remove(bpy.data.objects[name])
    driver.view3d().spaces[0].overlay.show_relationship_lines = False
    timing.time_callbacks()
    yield from driver.open_sidebar("IRGS++")
    yield from browsing.engine_ready()
    yield from find_cameras(photographs)
    yield from look_at_masks()
    yield from reconstruct()
    shutil.rmtree(work, ignore_errors=True)


def find_cameras(photographs: Path) -> Iterator[float]:
    """Choose the photographs, press Find Cameras, and wait until cameras, points and the sphere are in the scene."""
    settings = bpy.context.scene.irgspp
    settings.dataset = f"//{photographs.name}"
    yield from driver.wait(lambda: settings.inspected, 120)
    facts = json.loads(settings.inspected)
    timing.figures["estimates"] = f"{facts['capture']['text']} for the cameras; {facts['jobs'][settings.preset]['text']} with them"
    yield 1.0
    driver.sidebar_shot("70_photographs")
    yield from browsing.reach("irgspp.reconstruct")
    driver.sidebar_shot("70_estimate")
    yield from browsing.press_button("irgspp.capture")
    job = yield from browsing.started_job()
    assert job.kind == "capture", job.kind
    yield from driver.wait(lambda: job.finished or (job.phase == "match photographs" and job.step), PATIENCE)
    yield 1.0
    driver.shot("71_matching")
    driver.sidebar_shot("71_matching_sidebar")
    yield from driver.wait(lambda: job.finished or job.phase == "cut out the object", PATIENCE)
    driver.sidebar_shot("72_cutting_out")
    yield from driver.wait(lambda: job.finished, PATIENCE)
    assert job.state == "done" and not job.error, (job.state, job.error)
    yield from driver.wait(lambda: sphere() is not None, 300)
    yield from browsing.frame_selected()
    with driver.override():
        bpy.ops.view3d.view_all(use_all_regions=False)
    yield 1.0
    driver.shot("73_cameras_and_sphere")
    driver.sidebar_shot("73_cameras_sidebar")
    assert settings.dataset_path().name == "photos_capture", settings.dataset
    reasons = dict(driver.extension_module("irgspp_addon.importer.capture_file").read_capture(settings.dataset_path()).left_out)
    assert "\n" not in reasons[Path(NO_PHOTOGRAPH).stem], reasons  # photographs are named without suffix
    assert any(thing.type == "CAMERA" and len(thing.data.background_images) for thing in bpy.data.objects)


def sphere() -> bpy.types.Object | None:
    """Return the sphere around the object; None before the import."""
    return next((thing for thing in bpy.context.scene.objects if thing.type == "EMPTY" and thing.empty_display_type == "SPHERE"), None)


def look_at_masks() -> Iterator[float]:
    """Show the contact sheet, paint on a mask by the mouse, and save it."""
    yield from browsing.press_button("irgspp.show_image", across=0.7)
    yield 2.0
    driver.shot("74_contact_sheet")
    yield from browsing.close_other_windows()
    camera = next(thing for thing in bpy.context.scene.objects if thing.type == "CAMERA")
    with driver.override():
        bpy.ops.object.select_all(action="DESELECT")
    camera.select_set(True)
    bpy.context.view_layer.objects.active = camera
    yield 1.0
    editor = browsing.open_editor("IMAGE_EDITOR")
    yield 1.0
    yield from browsing.press_button("irgspp.edit_mask")
    yield 3.0
    masks = driver.extension_module("irgspp_addon.importer.mask_image")
    image = editor.spaces.active.image
    assert image is not None and masks.MASK in image, image
    driver.shot("75_mask")
    mask = Path(image[masks.MASK])
    before = mask.read_bytes() if mask.is_file() else b""
    driver.region("UI", editor).active_panel_category = "IRGS++"
    editor.tag_redraw()
    yield 1.0
    yield from driver.click("irgspp.mask_brush", area=editor, across=0.25)
    assert bpy.context.tool_settings.image_paint.brush.blend == "ERASE_ALPHA"
    paint_across(driver.region("WINDOW", editor))
    yield 3.0
    driver.shot("76_mask_painted")
    bpy.ops.irgspp.save_masks()
    assert mask.read_bytes() != before, "the mask was not painted on"
    if before:
        mask.write_bytes(before)  # the reconstruction is to see the mask as it was found
    with bpy.context.temp_override(window=driver.window(), area=editor):
        bpy.ops.screen.area_close()
    yield 1.0


def paint_across(place: bpy.types.Region) -> None:
    """Draw a stroke across the middle of an Image Editor."""
    x, y = place.x + 0.35 * place.width, driver.window().height - (place.y + 0.5 * place.height)
    words = ["xdotool", "mousemove", f"{x:.0f}", f"{y:.0f}", "sleep", "0.3", "mousedown", "1"]
    for step in range(1, 11):
        words += ["mousemove", f"{x + 0.03 * step * place.width:.0f}", f"{y:.0f}", "sleep", "0.05"]
    subprocess.Popen([*words, "mouseup", "1"])


def reconstruct() -> Iterator[float]:
    """Reconstruct a draft of what the sphere surrounds, and look at the object."""
    settings = bpy.context.scene.irgspp
    settings.preset = "draft"
    yield from browsing.scrolled("scroll_up")
    yield from browsing.press_button("irgspp.reconstruct")
    job = yield from browsing.started_job()
    yield from driver.wait(lambda: job.finished or (job.phase == "first stage" and job.fraction > 0.5 and job.preview), PATIENCE)
    yield 1.0
    driver.shot("77_reconstructing")
    driver.sidebar_shot("77_reconstructing_sidebar")
    yield from driver.wait(lambda: job.finished, PATIENCE)
    yield 2.0
    assert job.state == "done" and not job.error, (job.state, job.error)
    assert any(thing.type == "MESH" and len(thing.data.polygons) > 1000 for thing in bpy.context.scene.objects)
    yield from browsing.frame_selected()
    driver.shot("78_object")
    driver.view3d().spaces[0].shading.type = "MATERIAL"
    yield 40.0  # shaders are compiled
    driver.shot("79_object_material")
    driver.sidebar_shot("79_object_sidebar")


driver.run_story(story)
