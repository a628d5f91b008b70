# SPDX-License-Identifier: GPL-3.0-or-later
"""Story of an unsaved scene: a demonstration is cancelled, the scene saved, opened again and moved; the result arrives, once."""

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

# Schedules of seconds, but for the first stage: it has to last until a slow robot cancels it, and is finished early afterwards
SETTINGS = (
    "first.iterations=20000 first.gaussians=3000 first.stereo=off second.points=300 second.rows=8 second.iterations=5 second.pixels=32 "
    "second.samples=8 second.pool=1000 second.radiance_iterations=5 second.normal_iterations=4 surface.voxels=64 surface.triangles=4000 "
    "surface.texture=256"
)


def story() -> Iterator[float]:
    """Run the story."""
    work = Path(tempfile.mkdtemp(prefix="irgspp-story-"))
    yield from driver.open_sidebar("IRGS++")
    yield from browsing.engine_ready()
    timing.time_callbacks()
    shutil.copytree(Path(str(sys.modules[driver.MODULE].__file__)).parent / "core" / "demo_data", work / "project" / "monkey")
    settings = bpy.context.scene.irgspp
    settings.dataset, settings.preset = str(work / "project" / "monkey"), "draft"
    settings.materials, settings.overrides = "low-gloss", SETTINGS
    yield from driver.wait(lambda: settings.inspected, 60)
    yield 3.0
    driver.sidebar_shot("80_chosen")
    yield from stop_and_save(work / "project" / "scene.blend")
    yield from resume(work / "project" / "scene.blend")
    yield from move(work / "project", work / "moved")
    yield from relight(work / "moved" / "monkey" / "envs" / "sunset.exr")
    shutil.rmtree(work, ignore_errors=True)


def stop_and_save(file: Path) -> Iterator[float]:
    """Start a reconstruction from the unsaved scene, cancel it, and save the scene."""
    yield from browsing.press_button("irgspp.reconstruct")
    job = yield from browsing.started_job()
    yield from driver.wait(lambda: job.phase == "first stage" and job.step > 20, 300)
    driver.shot("81_running")
    yield from browsing.press_button("irgspp.job_cancel", across=0.7)
    yield from driver.wait(lambda: job.finished, 60)
    yield 1.5
    driver.sidebar_shot("82_cancelled")
    bpy.ops.wm.save_as_mainfile(filepath=str(file))
    yield 1.0


def resume(file: Path) -> Iterator[float]:
    """Open another file, then the saved one, and resume by the big button."""
    with driver.override():
        bpy.ops.wm.read_homefile()
    yield 2.0
    with driver.override():
        bpy.ops.wm.open_mainfile(filepath=str(file))
    yield 2.0
    yield from driver.open_sidebar("IRGS++")
    yield from browsing.press_button("irgspp.job_resume")
    job = yield from browsing.started_job()
    yield from driver.wait(lambda: job.state == "running" and job.phase == "first stage" and job.step > 20, 300)
    yield from browsing.press_button("irgspp.job_finish", across=0.25)
    yield from driver.wait(lambda: job.finished, 900)
    yield 3.0
    driver.shot("83_resumed")
    assert job.state == "done" and not job.error, (job.state, job.error)
    assert len(results()) == 1, results()


def move(project: Path, place: Path) -> Iterator[float]:
    """Save, move the whole project, open it at its new place, and import the run again from there."""
    bpy.ops.wm.save_mainfile()
    shutil.move(project, place)
    with driver.override():
        bpy.ops.wm.open_mainfile(filepath=str(place / "scene.blend"))
    yield 2.0
    yield from driver.open_sidebar("IRGS++")
    driver.sidebar_shot("84_moved")
    assert bpy.context.scene.irgspp.run_path() == place / "monkey_irgspp"
    yield from browsing.press_button("irgspp.import_run")
    yield 2.0
    assert len(results()) == 1, results()
    driver.shot("85_imported_again")


def relight(hdri: Path) -> Iterator[float]:
    """Open an HDRI in the panel, turn it, and change the resolution of the preview that runs."""
    yield from browsing.press_button("irgspp.open_hdri", across=0.25)
    yield from browsing.confirm_files("86_hdri", directory=hdri.parent, file=hdri.name)
    yield from driver.wait(lambda: bpy.context.scene.world.name == hdri.stem, 10)
    yield from browsing.press_button("irgspp.relight_preview")
    preview = driver.extension_module("irgspp_addon.relight.preview")
    follower = driver.extension_module("irgspp_addon.relight.live_image").follower_of(preview.CHANNEL)
    yield from driver.wait(lambda: follower.done or follower.failed, 180)
    assert not follower.failed, follower.message
    controls = driver.extension_module("irgspp_addon.world.light_controls").light_controls(bpy.context.scene.world)
    controls.rotation.default_value[2] = 2.0
    yield from driver.wait(lambda: not follower.done, 10, step=0.02)
    yield from driver.wait(lambda: follower.done, 120)
    bpy.context.scene.irgspp.preview_resolution = 128
    yield from driver.wait(lambda: not follower.done, 10, step=0.02)
    yield from driver.wait(lambda: follower.done, 120)
    assert max(bpy.data.images[preview.IMAGE].size) == 128
    yield 1.0
    driver.shot("87_relit")
    yield from browsing.close_other_windows()
    driver.sidebar_shot("88_relight_sidebar")


def results() -> list[str]:
    """Return the names of the reconstructed objects."""
    return [thing.name for thing in bpy.context.scene.objects if thing.type == "MESH" and thing.name != "Cube"]


driver.run_story(story)
