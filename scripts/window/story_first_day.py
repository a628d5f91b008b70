# SPDX-License-Identifier: GPL-3.0-or-later
"""Story of a first day: set up the engine, inspect photographs, reconstruct them, relight the object by an HDRI that turns."""

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
import timing

# Short schedules, so that the story ends in a minute or two; the photographs have 64x64 pixels.
SETTINGS = "first.iterations=300 first.trial_iterations=60 first.gaussians=8000 surface.voxels=96 surface.triangles=8000"


def story() -> Iterator[float]:
    """Run the story."""
    work = Path(tempfile.mkdtemp(prefix="irgspp-story-"))
    demo = Path(str(sys.modules[driver.MODULE].__file__)).parent / "core" / "demo_data"
    photographs = Path(shutil.copytree(demo, work / "monkey"))
    bpy.ops.wm.save_as_mainfile(filepath=str(work / "first_day.blend"))  # so that the folder can be named relative to it
    driver.view3d().spaces[0].overlay.show_relationship_lines = False
    timing.time_callbacks()
    yield from driver.open_sidebar("IRGS++")
    yield from set_up_engine()
    yield from look_at(photographs)
    yield from reconstruct(work / "monkey_irgspp")
    yield from show_result()
    yield from relight(photographs / "envs" / "sunset.exr")
    yield from see_jobs()
    shutil.rmtree(work, ignore_errors=True)


def set_up_engine() -> Iterator[float]:
    """Set up the engine in the preferences, to which the panel leads without one."""
    driver.sidebar_shot("01_no_engine")
    yield from driver.find("preferences.addon_show")
    yield from browsing.engine_ready()
    driver.shot("03_start")
    driver.sidebar_shot("03_start_sidebar")


def look_at(photographs: Path) -> Iterator[float]:
    """Inspect a folder and import its cameras."""
    settings = bpy.context.scene.irgspp
    settings.dataset = f"//{photographs.name}"
    yield 1.0
    driver.sidebar_shot("04_chosen")
    yield from driver.wait(lambda: settings.inspected, 60)
    yield 2.0
    driver.sidebar_shot("05_inspected")
    yield from browsing.press_button("irgspp.import_dataset")
    yield from driver.wait(lambda: any(thing.type == "CAMERA" and len(thing.data.background_images) for thing in bpy.data.objects), 60)
    yield from frame_all()
    driver.shot("06_cameras")


def reconstruct(run: Path) -> Iterator[float]:
    """Reconstruct, with images of the progress and of the object."""
    settings = bpy.context.scene.irgspp
    settings.preset, settings.overrides = "draft", SETTINGS
    assert settings.run_path() == run
    yield from browsing.press_button("irgspp.reconstruct")
    job = yield from browsing.started_job()
    yield from browsing.first_picture(job, "07_first_picture")
    yield from driver.wait(lambda: job.finished or (job.phase == "first stage" and job.fraction > 0.5 and job.preview), 600)
    yield 1.0
    (points,) = browsing.in_progress()
    assert len(points.data.vertices) > 500 and points.visible_get()
    driver.shot("07_running")
    driver.sidebar_shot("07_running_sidebar")
    yield from driver.wait(lambda: job.finished or any(len(one.data.polygons) for one in browsing.in_progress()), 600)
    yield 1.0
    driver.shot("07_surface")
    yield from browsing.trained(job)
    assert not browsing.in_progress()
    yield 30.0  # shaders are compiled
    driver.shot("08_done")
    assert_arranged()


def assert_arranged() -> None:
    """Check that the result is what is seen: framed in Material Preview, without cameras, cube and lamp."""
    scene, space = bpy.context.scene, driver.view3d().spaces[0]
    seen = [thing.name for thing in scene.objects if thing.visible_get() and thing.type in ("CAMERA", "LIGHT", "MESH")]
    assert len(seen) == 2 and "Camera" in seen, seen  # the object, and Blender's own camera
    assert space.shading.type == "MATERIAL" and scene.world.name.endswith(" light"), (space.shading.type, scene.world)
    thing = bpy.context.object
    assert (space.region_3d.view_location - thing.matrix_world.translation).length < 1.0 and space.region_3d.view_distance < 10


def show_result() -> Iterator[float]:
    """Show the result's panel, and look through a camera."""
    yield 10.0  # shaders are compiled
    driver.shot("09_result")
    driver.sidebar_shot("09_result_sidebar")
    yield from look_through_a_camera()
    driver.view3d().spaces[0].shading.type = "SOLID"


def look_through_a_camera() -> Iterator[float]:
    """Look through a photograph's camera: first at the object, then with the photograph half over it."""
    thing = bpy.context.object
    yield from browsing.press_button("irgspp.step_photograph", across=0.5)
    yield from driver.wait(lambda: bpy.context.scene.camera.name != "Camera", 5)
    background = bpy.context.scene.camera.data.background_images[0]
    yield 3.0
    driver.shot("09_through_camera")
    background.display_depth, background.alpha = "FRONT", 0.5
    yield 2.0
    driver.shot("09_through_camera_mixed")
    background.display_depth, background.alpha = "BACK", 1.0
    driver.view3d().spaces[0].region_3d.view_perspective = "PERSP"
    bpy.context.view_layer.objects.active = thing


def relight(hdri: Path) -> Iterator[float]:
    """Relight the object by an HDRI that is opened in the panel, then turn it."""
    yield from browsing.press_button("irgspp.open_hdri", across=0.25)
    yield from browsing.confirm_files("10_hdri", directory=hdri.parent, file=hdri.name)
    yield from driver.wait(lambda: bpy.context.scene.world.name == hdri.stem, 10)
    controls = driver.extension_module("irgspp_addon.world.light_controls").light_controls(bpy.context.scene.world)
    editor = browsing.open_editor("IMAGE_EDITOR")
    yield 1.0
    yield from browsing.frame_selected()
    yield from browsing.press_button("irgspp.relight_preview")
    preview = driver.extension_module("irgspp_addon.relight.preview")
    follow = driver.extension_module("irgspp_addon.relight.live_image")
    follower = follow.follower_of(preview.CHANNEL)
    yield from driver.wait(lambda: follower.done or follower.failed, 120)
    assert not follower.failed, follower.message
    with driver.override(area=editor):
        bpy.ops.image.view_all(fit_view=True)
    yield 1.0
    driver.shot("10_relit")
    controls.rotation.default_value[2] = 2.0
    yield from driver.wait(lambda: not follower.done, 10, step=0.02)
    yield from driver.wait(lambda: follower.done, 60)
    yield 1.0
    driver.shot("11_turned")
    driver.sidebar_shot("11_turned_sidebar")
    bpy.context.scene.irgspp.preview_resolution = 128
    yield from driver.wait(lambda: not follower.done, 10, step=0.02)
    yield from driver.wait(lambda: follower.done, 60)
    assert max(bpy.data.images[preview.IMAGE].size) == 128
    yield from browsing.press_button("irgspp.relight_stop")
    assert not preview.preview_running()


def see_jobs() -> Iterator[float]:
    """Show the list of jobs."""
    yield from browsing.scrolled("scroll_down")
    part = driver.region()
    yield from driver.click_at(part.x + 60, part.y + 14)  # the last panel is closed at first; its header is the last row
    yield from browsing.scrolled("scroll_down")
    driver.shot("12_jobs")
    driver.sidebar_shot("12_jobs_sidebar")


def frame_all() -> Iterator[float]:
    """Frame all objects in the 3D View."""
    with driver.override():
        bpy.ops.view3d.view_all(use_all_regions=False)
    yield 1.0


driver.run_story(story)
