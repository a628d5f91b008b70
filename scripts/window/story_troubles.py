# SPDX-License-Identifier: GPL-3.0-or-later
"""What a person sees where something is missing or asked for: preferences, folders that are no datasets, a run that would be replaced."""

import os
import shutil
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path

sys.path.insert(0, os.path.dirname(os.path.abspath(__file__)))

import bpy
import hands

MODULE = "bl_ext.user_default.irgspp"


def story() -> Iterator[float]:
    work = Path(tempfile.mkdtemp(prefix="irgspp-story-"))
    bpy.ops.wm.save_as_mainfile(filepath=str(work / "troubles.blend"))
    settings, jobs = bpy.context.scene.irgspp, sys.modules[f"{MODULE}.irgspp_addon.jobs.queue"]
    yield from hands.open_sidebar("IRGS++")
    yield from open_preferences()
    yield from hands.open_sidebar("IRGS++")
    yield from hands.click("irgspp.check_engine")
    yield from hands.wait(lambda: sys.modules[f"{MODULE}.irgspp_addon.engine.process"].status().state == "ok", 120)

    (work / "empty").mkdir()
    settings.dataset = "//empty"
    yield 1.0
    yield from hands.click("irgspp.inspect_dataset", across=0.25)
    yield from hands.wait(lambda: not jobs.unfinished(), 60)
    yield 1.5
    hands.sidebar_shot("22_no_dataset")

    demo = Path(str(sys.modules[MODULE].__file__)).parent / "core" / "demo_data"
    shutil.copytree(demo, work / "monkey")
    settings.dataset = "//monkey"
    settings.overrides = "first.iterations=many"
    yield 1.0
    yield from hands.click("irgspp.reconstruct")
    yield from hands.wait(lambda: not jobs.unfinished(), 60)
    yield 1.5
    hands.sidebar_shot("23_bad_setting")

    settings.overrides, settings.preset = "first.iterations=3000", "draft"
    yield 1.0
    yield from hands.click("irgspp.reconstruct")
    yield from hands.wait(jobs.running, 30)
    job = jobs.running()[0]
    yield from hands.wait(lambda: job.phase == "first stage" and job.step > 20, 300)
    yield from hands.click("irgspp.job_cancel", across=0.7)
    yield from hands.wait(lambda: job.finished, 60)
    yield 1.5
    hands.sidebar_shot("24_cancelled")
    assert job.state == "cancelled", job.state

    yield from hands.click("irgspp.reconstruct", across=0.7)
    yield 1.0
    hands.shot("25_replace")
    hands.key("Escape")
    yield 1.0
    assert not jobs.unfinished()
    yield from hands.click("irgspp.job_resume", across=0.25)
    yield from hands.wait(lambda: job.state == "running" and job.step > 20, 120)
    yield from hands.click("irgspp.job_finish", across=0.25)
    yield 1.0
    hands.sidebar_shot("26_finishing_early")
    yield from hands.wait(lambda: job.finished, 600)
    assert job.state == "done" and not job.error, (job.state, job.error)
    shutil.rmtree(work, ignore_errors=True)


def open_preferences() -> Iterator[float]:
    """By the panel's button; they come in a window of their own."""
    yield from hands.click("preferences.addon_show")
    yield from hands.wait(lambda: len(bpy.context.window_manager.windows) > 1, 10)
    yield 2.0
    hands.shot("20_preferences")
    bpy.context.preferences.addons[MODULE].preferences.engine_python = hands.ENGINE
    hands.redraw()
    yield 2.0
    hands.shot("21_preferences_existing")
    with bpy.context.temp_override(window=bpy.context.window_manager.windows[-1]):
        bpy.ops.wm.window_close()
    yield 1.0


hands.tell(story)
