# SPDX-License-Identifier: GPL-3.0-or-later
"""Story of quitting Blender during a reconstruction: the next Blender says so, not that it was cancelled, and resumes it."""

import os
import shutil
import sys
from collections.abc import Iterator
from pathlib import Path

sys.path.insert(0, os.path.dirname(os.path.abspath(__file__)))

import bpy
import browsing
import driver

# The first stage has to last until Blender is quit, and is finished early afterwards.
SETTINGS = (
    "first.iterations=20000 first.gaussians=3000 first.stereo=off second.points=300 second.rows=8 second.iterations=5 second.pixels=32 "
    "second.samples=8 second.pool=1000 second.radiance_iterations=5 second.normal_iterations=4 surface.voxels=64 surface.triangles=4000 "
    "surface.texture=256"
)
WORK = driver.OUTPUT / "work"  # which both Blenders use


def story() -> Iterator[float]:
    """Run the story: in the first Blender until it quits, then in the second one."""
    if not driver.AGAIN:
        yield from quit_during_job()
    else:
        yield from resume()
        shutil.rmtree(WORK, ignore_errors=True)


def quit_during_job() -> Iterator[float]:
    """Start a reconstruction, save the scene and quit Blender."""
    shutil.rmtree(WORK, ignore_errors=True)
    shutil.copytree(Path(str(sys.modules[driver.MODULE].__file__)).parent / "core" / "demo_data", WORK / "monkey")
    bpy.ops.wm.save_as_mainfile(filepath=str(WORK / "scene.blend"))
    yield from driver.open_sidebar("IRGS++")
    yield from browsing.engine_ready()
    settings = bpy.context.scene.irgspp
    settings.dataset, settings.preset, settings.materials, settings.overrides = "//monkey", "draft", "low-gloss", SETTINGS
    yield from driver.wait(lambda: settings.inspected, 60)
    yield from browsing.press_button("irgspp.reconstruct")
    job = yield from browsing.started_job()
    yield from driver.wait(lambda: job.finished or (job.phase == "first stage" and job.step > 20), 300)
    driver.shot("100_running")
    bpy.ops.wm.save_mainfile()
    driver.quit_and_go_on()
    yield 60.0
    raise RuntimeError("Blender has not quit")


def resume() -> Iterator[float]:
    """Open the scene again, see what the panel says, and resume by the big button."""
    with driver.override():
        bpy.ops.wm.open_mainfile(filepath=str(WORK / "scene.blend"))
    yield 2.0
    yield from driver.open_sidebar("IRGS++")
    yield from browsing.engine_ready()
    (job,) = [job for job in driver.extension_module("irgspp_addon.jobs.queue").all_jobs() if job.kind == "reconstruct"]
    yield from driver.wait(lambda: job.finished, 60)
    yield from browsing.reach("irgspp.job_resume")
    driver.shot("101_opened_again")
    driver.sidebar_shot("101_opened_again_sidebar")
    assert (job.state, job.error) == ("cancelled", "Blender was closed"), (job.state, job.error)
    yield from browsing.press_button("irgspp.job_resume")
    yield from driver.wait(lambda: job.state == "running" and job.phase == "first stage" and job.step > 20, 300)
    yield from browsing.press_button("irgspp.job_finish", across=0.25)
    yield from driver.wait(lambda: job.finished, 900)
    yield 3.0
    driver.shot("102_resumed")
    assert job.state == "done" and not job.error, (job.state, job.error)


driver.run_story(story)
